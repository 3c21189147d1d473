"""TOML checked against a model: all mistakes in one message, each with file, line and key."""

import re
import tomllib
import typing
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from kedge.core.errors import ConfigError, KedgeError
from kedge.core.registry import unknown

M = TypeVar("M", bound=BaseModel)
Keys = tuple[str | int, ...]


# Keys that were renamed in 0.2: said for one version.
RENAMED = {
    "slow": "augmented",
    "walk": "random_walk",
    "really": "true_parameters",
    "sweep": "all_targets",
}


class Strict(BaseModel):
    """A table of a TOML file: no unknown keys, no guessing of types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    def validation_errors(self) -> Iterator[str]:
        """What is wrong beyond types, each as ``key: message``."""
        return iter(())

    @model_validator(mode="after")
    def _consistent(self):
        if found := list(self.validation_errors()):
            raise ValueError("\n".join(found))
        return self


def read_toml(
    path: Path,
    model: type[M],
    overrides: Mapping[str, str] | None = None,
    error: type[KedgeError] = ConfigError,
    complete: Callable[[dict[str, Any], Path], dict[str, Any]] = lambda tree, path: tree,
) -> M:
    """Read a file into ``model``; ``overrides`` are values, as TOML, by dotted key.

    ``complete`` adds what the file leaves to others, before the overrides.

    Raises:
        error: the file is missing, is no TOML or does not fit the model; the message has one
            line for each mistake.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        tree = tomllib.loads(text)
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as failure:
        raise error(f"{path}: cannot be read: {failure}") from failure
    except tomllib.TOMLDecodeError as failure:
        at = re.search(r"\(at line (\d+), column (\d+)\)", str(failure))
        place = f"{path}:{at[1]}" if at else f"{path}"
        raise error(f"{place}: no readable TOML: {failure}") from failure
    tree, changed = complete(tree, path), set()
    for key, value in (overrides or {}).items():
        changed.add(_set(tree, key, value))
    try:
        return model.model_validate(tree)
    except ValidationError as failure:
        found = _validation_errors(failure, model)
    lines = []
    for keys, message in found:
        at = None if any(keys[: len(c)] == c for c in changed) else _line_of(text, keys)
        place = f"{path}:{at}" if at else f"{path}"
        lines.append(f"{place}: {'.'.join(map(str, keys))}: {message}")
    raise error("\n".join(lines))


def _set(tree: dict[str, Any], key: str, text: str) -> Keys:
    """Put one override into the tree; a bare word needs no quotes."""
    place = f"--set {key}={text}"
    try:
        nested, keys = tomllib.loads(f"{key} = 0"), []
        while isinstance(nested, dict):
            ((name, nested),) = nested.items()
            keys.append(name)
    except ValueError as failure:
        raise ConfigError(f"{place}: found {key!r}, expected a dotted key") from failure
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError as failure:
        if not re.fullmatch(r"[A-Za-z_][\w.:=,+-]*", text):
            raise ConfigError(f"{place}: found {text!r}, expected a TOML value") from failure
        value = text
    table = tree
    for depth, name in enumerate(keys[:-1], start=1):
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise ConfigError(f"{place}: {'.'.join(keys[:depth])} is a value, not a table")
    table[keys[-1]] = value
    return tuple(keys)


def _validation_errors(
    failure: ValidationError, model: type[BaseModel]
) -> Iterator[tuple[Keys, str]]:
    for item in failure.errors(include_url=False):
        keys, kind = item["loc"], item["type"]
        if kind == "extra_forbidden":
            known, key = _known(model, keys[:-1]), str(keys[-1])
            if RENAMED.get(key) in known:
                yield keys, f"this key is called {RENAMED[key]!r} now"
            else:
                yield keys, unknown("key", key, known)
        elif kind == "missing":
            yield keys, "this key is missing"
        elif kind == "value_error":
            for line in item["msg"].removeprefix("Value error, ").splitlines():
                below, _, message = line.partition(": ")
                yield (*keys, *below.split(".")), message
        else:
            expected = item["msg"].removeprefix("Input should be ")
            yield keys, f"found {item['input']!r}, expected {expected}"


def _known(kind: Any, keys: Keys) -> list[str]:
    """The keys of the table at ``keys``."""
    for key in keys:
        if typing.get_origin(kind) is dict:
            kind = typing.get_args(kind)[1]
        else:
            kind = kind.model_fields[key].annotation
        # Of ``Table | None``, the table.
        options = (kind, *typing.get_args(kind))
        tables = (
            o for o in options if typing.get_origin(o) is dict or hasattr(o, "model_fields")
        )
        kind = next(tables, kind)
    return list(getattr(kind, "model_fields", ()))


def _line_of(text: str, keys: Keys) -> int | None:
    """Line of a key, or of the innermost table around it that has one."""
    names = [str(key) for key in keys]
    best, depth = None, 0
    table: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[+\s*([^\]]+?)\s*\]", line):
            table = path = [part.strip(" \"'") for part in header[1].split(".")]
        elif entry := re.match(r"\s*([\w.\"'-]+)\s*=", line):
            path = [*table, *(part.strip("\"'") for part in entry[1].split("."))]
        else:
            continue
        if len(path) > depth and names[: len(path)] == path:
            best, depth = number, len(path)
    return best
