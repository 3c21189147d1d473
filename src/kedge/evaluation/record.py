"""Scores as JSON, by the types of their fields: the same rules write them and their schema.

A :class:`~kedge.evaluation.scores.Score` in a field ``x`` is written as ``x`` and ``x_ci``, a
mapping of scores likewise; a field marked ``inline`` is written among those of its owner.
"""

import ast
import dataclasses
import functools
import inspect
import itertools
import textwrap
import typing
from collections.abc import Iterator, Mapping, Sequence
from types import NoneType, UnionType
from typing import Any, NamedTuple, get_args, get_origin

from kedge.evaluation.scores import Score

SCALARS = {bool: "boolean", int: "integer", float: "number", str: "string"}


class Leaf(NamedTuple):
    """A value of a tree of scores, and the keys under which JSON has it."""

    keys: tuple[str, ...]
    interval_keys: tuple[str, ...]
    """Of its interval."""
    value: Any
    """A score, or what JSON takes as it is."""


def leaves(
    tree: Any, keys: tuple[str, ...] = (), place: int = 0, inline: bool = False
) -> Iterator[Leaf]:
    """The values of a tree of dataclasses, named tuples and mappings, in order.

    ``place`` is that of the last field among the keys: an interval's key differs there.
    """
    if isinstance(tree, Score):
        yield Leaf(keys, (*keys[:place], f"{keys[place]}_ci", *keys[place + 1 :]), tree)
    elif (fields := _fields(type(tree))) is not None:
        for name, about in fields.items():
            value = getattr(tree, name)
            if (about.optional or about.inline) and (value is None or value == {}):
                continue
            if about.inline:
                yield from leaves(value, keys, place)
            else:
                yield from leaves(value, (*keys, name), len(keys))
    elif isinstance(tree, Mapping) and (tree or not keys):
        for key, value in tree.items():
            yield from leaves(value, (*keys, str(key)), place)
    elif isinstance(tree, Sequence) and not isinstance(tree, str):
        yield Leaf(keys, (), [record(item) for item in tree])
    else:
        yield Leaf(keys, (), tree)


def record(tree: Any) -> Any:
    """A tree of scores as nested dictionaries, lists and plain values."""
    if not isinstance(tree, Mapping | Sequence) and _fields(type(tree)) is None:
        return tree
    if isinstance(tree, str):
        return tree
    if isinstance(tree, Sequence) and _fields(type(tree)) is None:
        return [record(item) for item in tree]
    root: dict[str, Any] = {}
    for leaf in leaves(tree):
        if isinstance(leaf.value, Score):
            _put(root, leaf.keys, leaf.value.value)
            _put(root, leaf.interval_keys, list(leaf.value[1:]))
        else:
            _put(root, leaf.keys, leaf.value)
    return root


def by_name(tree: Any) -> dict[str, Score]:
    """Every number of a tree by its dotted name; what has no interval is one by itself."""
    numbers = {}
    for keys, _, value in leaves(tree):
        if isinstance(value, Score):
            numbers[".".join(keys)] = value
        elif isinstance(value, int | float):
            numbers[".".join(keys)] = Score(*[float(value)] * 3)
    return numbers


def schema(title: str, *kinds: type) -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of what :func:`record` makes of any of the ``kinds``."""
    definitions: dict[str, Any] = {}
    choices = [_schema(kind, definitions) for kind in kinds]
    dialect = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": dialect, "title": title, "anyOf": choices, "$defs": definitions}


class _Field(NamedTuple):
    """What is written of a field."""

    type: Any
    optional: bool
    inline: bool
    text: str


@functools.cache
def _fields(cls: type) -> dict[str, _Field] | None:
    """The fields of a dataclass or named tuple; None of anything else."""
    if cls is Score or not (dataclasses.is_dataclass(cls) or hasattr(cls, "_fields")):
        return None
    hints, texts = typing.get_type_hints(cls), _docstrings(cls)
    if not dataclasses.is_dataclass(cls):
        return {n: _Field(hints[n], False, False, texts.get(n, "")) for n in hints}
    return {
        field.name: _Field(
            hints[field.name],
            field.default is not dataclasses.MISSING
            or field.default_factory is not dataclasses.MISSING,
            bool(field.metadata.get("inline")),
            texts.get(field.name, ""),
        )
        for field in dataclasses.fields(cls)
    }


def _docstrings(cls: type) -> dict[str, str]:
    """The strings that stand below the fields of a class."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
    body = tree.body if isinstance(tree, ast.ClassDef) else []
    texts = {}
    for above, below in itertools.pairwise(body):
        if isinstance(above, ast.AnnAssign) and isinstance(above.target, ast.Name):
            if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
                texts[above.target.id] = " ".join(str(below.value.value).split())
    return texts


def _object_schema(cls: type, definitions: dict[str, Any]) -> dict[str, Any]:
    properties: dict[str, Any] = {}
    required: list[str] = []
    others: Any = False
    for name, about in (_fields(cls) or {}).items():
        if about.inline and get_origin(about.type) is Mapping:
            others = _schema(get_args(about.type)[1], definitions)
            continue
        if about.inline:
            whole = _object_schema(about.type, definitions)
            properties |= whole["properties"]
            required += whole["required"]
            continue
        described = {"description": about.text} if about.text else {}
        properties[name] = _schema(about.type, definitions) | described
        required += [] if about.optional else [name]
        if (interval := _interval_schema(about.type)) is not None:
            properties[f"{name}_ci"] = interval
            required += [] if about.optional else [f"{name}_ci"]
    text = inspect.cleandoc(cls.__doc__ or "").partition("\n\n")[0]
    return {
        "title": cls.__name__,
        "description": " ".join(text.split()),
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": others,
    }


def _interval_schema(annotation: Any) -> dict[str, Any] | None:
    """Of the key beside a score's, or beside a mapping of scores'."""
    ends = {"type": "array", "items": {"type": ["number", "null"]}, "maxItems": 2}
    ends |= {"minItems": 2, "description": "95 % confidence interval."}
    annotation = _present(annotation)
    if annotation is Score:
        return ends
    if get_origin(annotation) is Mapping and get_args(annotation)[1] is Score:
        return {"type": "object", "additionalProperties": ends}
    return None


def _schema(annotation: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    annotation = _present(annotation)
    if annotation is Any:
        return {}
    if annotation in (float, Score):
        return {"type": ["number", "null"]}
    if annotation in SCALARS:
        return {"type": SCALARS[annotation]}
    if get_origin(annotation) is Mapping:
        return {
            "type": "object",
            "additionalProperties": _schema(get_args(annotation)[1], definitions),
        }
    if get_origin(annotation) in (tuple, Sequence):
        return {"type": "array", "items": _schema(get_args(annotation)[0], definitions)}
    if annotation.__name__ not in definitions:
        definitions[annotation.__name__] = {}  # holds the place, should it contain itself
        definitions[annotation.__name__] = _object_schema(annotation, definitions)
    return {"$ref": f"#/$defs/{annotation.__name__}"}


def _present(annotation: Any) -> Any:
    """The type of a value that is there: ``X`` of ``X | None``."""
    if isinstance(annotation, UnionType) or get_origin(annotation) is typing.Union:
        (annotation,) = (part for part in get_args(annotation) if part is not NoneType)
    return annotation


def _put(root: dict[str, Any], keys: tuple[str, ...], value: Any) -> None:
    for key in keys[:-1]:
        root = root.setdefault(key, {})
    root[keys[-1]] = value
