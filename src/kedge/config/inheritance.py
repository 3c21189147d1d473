"""Files that say only how they differ from another; paths relative to where they stand."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kedge.config.plugins import load_modules
from kedge.config.simulated import simulated
from kedge.core.errors import ConfigError

Tree = dict[str, Any]
EXTENDS, WITHOUT, SCENARIO = "extends", "without", "scenario"


def completed(tree: Tree, path: Path, shipped: Mapping[str, Path]) -> Tree:
    """A file's tables over those of the file that it ``extends``, and so on.

    ``extends`` is a name among ``shipped`` or the path of a TOML file, relative to the one that
    says so. Tables are merged key by key; a value or a list takes the place of what was there,
    and so does a table that names another ``model``, with all that was said of the one before.
    ``without`` lists what is left out of the other file, by dotted keys. A scenario may extend
    a rig: see :func:`kedge.config.simulated.simulated`.

    Raises:
        ConfigError: that file is missing or no TOML, extends itself, or has not what is to be
            left out.
    """
    return _completed(tree, path, shipped, (path.resolve(),))


def _completed(
    tree: Tree, path: Path, shipped: Mapping[str, Path], seen: tuple[Path, ...]
) -> Tree:
    tree_here = placed(tree, path.parent)
    if EXTENDS not in tree_here:
        return tree_here
    name, lost = tree_here.pop(EXTENDS), tree_here.pop(WITHOUT, [])
    if not isinstance(name, str):
        raise ConfigError(
            f"{path}: {EXTENDS}: found {name!r}, expected the name of a shipped file or a path"
        )
    if name not in shipped:
        load_modules(path.parent / name)
    below = shipped.get(name, path.parent / name)
    if below.resolve() in seen:
        raise ConfigError(f"{path}: {EXTENDS}: found {name!r}, which extends this file again")
    try:
        base = tomllib.loads(below.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(
            f"{path}: {EXTENDS}: found {name!r}, expected a TOML file or one of "
            f"{', '.join(shipped)}: {error}"
        ) from error
    whole = _completed(base, below, shipped, (*seen, below.resolve()))
    for key in lost if isinstance(lost, list) else [lost]:
        if not _left_out(whole, str(key).split(".")):
            raise ConfigError(f"{path}: {WITHOUT}: found {key!r}, which is not in {name!r}")
    if SCENARIO in tree_here and SCENARIO not in whole:
        whole = simulated(whole, name)
    return merged(whole, tree_here)


def _left_out(tree: Tree, keys: list[str]) -> bool:
    """Whether there was something to leave out."""
    *tables, last = keys
    for key in tables:
        tree = tree.get(key, {})
        if not isinstance(tree, dict):
            return False
    return tree.pop(last, None) is not None


def merged(base: Tree, changes: Tree) -> Tree:
    """``changes`` over ``base``: see :func:`completed`."""
    if changes.get("model", base.get("model")) != base.get("model"):
        return changes
    tree = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        tree[key] = merged(base[key], value) if both else value
    return tree


def placed(tree: Tree, folder: Path) -> Tree:
    """The tree, with TOML files among models' ``parameters`` named from ``folder``.

    Whoever names a file by a relative path means it from the file in which it stands; what is
    typed on the command line is relative to where that was typed.
    """
    placed_tree = {}
    for key, value in tree.items():
        if key == "parameters" and isinstance(value, dict):
            placed_tree[key] = {name: _from(folder, given) for name, given in value.items()}
        else:
            placed_tree[key] = placed(value, folder) if isinstance(value, dict) else value
    return placed_tree


def _from(folder: Path, given: Any) -> Any:
    """A path, perhaps with changes after a colon; what is none stays as it is."""
    if not isinstance(given, str):
        return given
    name, colon, fragment = given.partition(":")
    if not name.endswith(".toml") or Path(name).is_absolute():
        return given
    return f"{folder / name}{colon}{fragment}"
