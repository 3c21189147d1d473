"""A user's own vehicles, sensors and filters: Python files that a rig file names."""

import contextlib
import importlib.util
import sys
import tomllib
import traceback
from pathlib import Path

from kedge.core.errors import ConfigError

LOADED: dict[str, Path] = {}
"""Name of a module -> the file that was run as it."""


def load_modules(rig: Path, seen: tuple[Path, ...] = ()) -> None:
    """Run the files that the key ``modules`` of a rig file lists, so that they register.

    Those of the file that it extends are run too. Paths are relative to the rig file. A rig
    with modules is as trusted as any program.

    Raises:
        ConfigError: a module is missing or cannot be run.
    """
    # What is wrong with the rig file itself is said when it is read as a whole.
    with contextlib.suppress(OSError, ValueError, RecursionError):
        tree = tomllib.loads(rig.read_text(encoding="utf-8-sig"))
        names, base = tree.get("modules", []), tree.get("extends")
        for name in names if isinstance(names, list) else []:
            if isinstance(name, str):
                _run((rig.parent / name).resolve(), f"{rig}: modules: {name}")
        if isinstance(base, str) and base.endswith(".toml") and rig.resolve() not in seen:
            load_modules(rig.parent / base, (*seen, rig.resolve()))


def place_in_plugin(error: BaseException) -> str | None:
    """File and line of a user's module in which something was raised; None if it was not."""
    frames = traceback.extract_tb(error.__traceback__)
    files = {str(path) for path in LOADED.values()}
    return next(
        (
            f"{frame.filename}:{frame.lineno}"
            for frame in reversed(frames)
            if frame.filename in files
        ),
        None,
    )


def place_of(member: type, method: str | None = None) -> str | None:
    """File and line where a class of a user's module, or its method, begins; None of others."""
    path = LOADED.get(member.__module__)
    code = getattr(getattr(member, method or "", None), "__code__", None)
    if path is None:
        return None
    return f"{path}:{code.co_firstlineno}" if code else f"{path}: {member.__name__}"


def _run(path: Path, place: str) -> None:
    name = f"kedge_module_{path.stem}"
    loaded = sys.modules.get(name)
    if loaded is not None and getattr(loaded, "__file__", None) == str(path):
        return
    if not path.is_file():
        raise ConfigError(f"{place}: no such file; paths are relative to the rig file")
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{place}: is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    LOADED[name] = path
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        # A user's own code may fail in any way; the rig is what cannot be used.
        del sys.modules[name]
        at = error.lineno if isinstance(error, SyntaxError) else None
        if inside := place_in_plugin(error):
            at = inside.rpartition(":")[2]
        raise ConfigError(f"{place}:{at or 1}: {type(error).__name__}: {error}") from error
