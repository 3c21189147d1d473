"""TOML checked against a model: all mistakes in one message, each with file, line and key."""

import json
import re
import tomllib
import typing
from collections import Counter
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


MOST_SHOWN = 80
"""Letters of a value that a message shows."""


class _Failed(Exception):
    """A check that failed itself, with what it raised as its cause."""


def shortened(value: Any) -> str:
    """A value as Python writes it, as far as a message has room."""
    text = repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def quoted(text: str) -> str:
    """A text as TOML writes it."""
    # JSON's escapes are TOML's; its surrogate pairs are not, so other scripts stay as they are.
    return json.dumps(text, ensure_ascii=False)


class Strict(BaseModel):
    """A table of a TOML file: no unknown keys, no guessing of types."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True
    )

    def validation_errors(self) -> Iterator[str]:
        """What is wrong beyond types, each as ``key: message``."""
        return iter(())

    @model_validator(mode="after")
    def _consistent(self):
        try:
            errors = list(self.validation_errors())
        except (ValueError, AssertionError) as error:
            # Pydantic would blame the file for what is wrong in the code that checks it.
            raise _Failed from error
        if errors:
            raise ValueError("\n".join(errors))
        return self


def read_toml(
    path: Path,
    model: type[M],
    overrides: Mapping[str, Any] | None = None,
    error: type[KedgeError] = ConfigError,
    complete: Callable[[dict[str, Any], Path], dict[str, Any]] = lambda tree, path: tree,
) -> M:
    """Read a file into ``model``; ``overrides`` are values by dotted key, words as TOML.

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
    except RecursionError:
        raise error(f"{path}: no readable TOML: tables or lists in too many others") from None
    except ValueError as failure:
        at = re.search(r"\(at line (\d+), column (\d+)\)", str(failure))
        place = f"{path}:{at[1]}" if at else f"{path}"
        raise error(f"{place}: no readable TOML: {failure}") from failure
    tree, changed = complete(tree, path), set()
    for key, value in (overrides or {}).items():
        changed.add(_set(tree, key, value))
    try:
        return model.model_validate(tree)
    except _Failed as failure:
        raise failure.__cause__ or failure from None
    except ValidationError as failure:
        errors = _validation_errors(failure, model)
    lines = []
    for keys, message in errors:
        at = None if any(keys[: len(c)] == c for c in changed) else _line_of(text, keys)
        place = f"{path}:{at}" if at else f"{path}"
        lines.append(f"{place}: {'.'.join(map(str, keys))}: {message}")
    raise error("\n".join(lines))


def _set(tree: dict[str, Any], key: str, value: Any) -> Keys:
    """Put an override into the tree: a value, or its TOML; a bare word needs no quotes."""
    text = str(value)
    place = f"--set {key}={text if len(text) < MOST_SHOWN else f'{text[:MOST_SHOWN]}...'}"
    try:
        nested, keys = tomllib.loads(f"{key} = 0"), []
        while isinstance(nested, dict):
            ((name, nested),) = nested.items()
            keys.append(name)
    except ValueError as failure:
        raise ConfigError(f"{place}: found {key!r}, expected a dotted key") from failure
    try:
        if isinstance(value, str):
            value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError) as failure:
        if not re.fullmatch(r"[A-Za-z_][\w.:=,+-]*", text):
            raise ConfigError(
                f"{place}: found {shortened(text)}, expected a TOML value"
            ) from failure
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
            yield keys, f"found {shortened(item['input'])}, expected {expected}"


def _known(kind: Any, keys: Keys) -> list[str]:
    """The keys of the table at ``keys``."""
    for key in keys:
        if typing.get_origin(kind) in (dict, list):
            kind = typing.get_args(kind)[-1]
        elif str(key) in getattr(kind, "model_fields", {}):
            kind = kind.model_fields[str(key)].annotation
        # Of ``Table | None``, the table.
        options = (kind, *typing.get_args(kind))
        tables = (
            o
            for o in options
            if typing.get_origin(o) in (dict, list) or hasattr(o, "model_fields")
        )
        kind = next(tables, kind)
    return list(getattr(kind, "model_fields", ()))


def _line_of(text: str, keys: Keys) -> int | None:
    """Line of a key, or of the innermost table around it that has one."""
    names = [str(key) for key in keys]
    best, depth = None, 0
    table: list[str] = []
    counts: Counter[str] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[+\s*([^\]]+?)\s*\]", line):
            table = path = [part.strip(" \"'") for part in header[1].split(".")]
            if line.lstrip().startswith("[["):
                table = path = [*path, str(counts[header[1]])]
                counts[header[1]] += 1
        elif entry := re.match(r"\s*([\w.\"'-]+)\s*=", line):
            path = [*table, *(part.strip("\"'") for part in entry[1].split("."))]
        else:
            continue
        if len(path) > depth and names[: len(path)] == path:
            best, depth = number, len(path)
    return best
