"""Registered models as files name them: their numbers and the parts of their fields."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import Field

from kedge.core.errors import UnknownName
from kedge.core.registry import Registry, unknown

Number = Annotated[float, Field(allow_inf_nan=False)]
Parameter = bool | int | Number | str | list[Number] | list[list[Number]]
"""What a model can be built with."""


def kinds_of(cls: type) -> dict[str, type]:
    """What can be set of a model as text: numbers, words, true or false, lists."""
    hints, kinds_by_name = get_type_hints(cls), {}
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        likely = [type(field.default), getattr(hint, "__origin__", hint), *get_args(hint)]
        # A default says its kind; what has none is known by its type.
        kinds = [kind for kind in likely if kind in KINDS]
        if kinds:
            kinds_by_name[field.name] = kinds[0]
    return kinds_by_name


def build_model(cls: type, parameters: Mapping[str, Parameter], **others: Any) -> Any:
    """An instance; numbers from a file become whole where the model's own are."""
    kinds = kinds_of(cls)
    fitting = {key: _fitting(value, kinds.get(key)) for key, value in parameters.items()}
    return cls(**fitting, **others)


def model_errors(
    registry: Registry, name: str, parameters: Mapping[str, Parameter]
) -> Iterator[str]:
    """Unknown names and values of the wrong kind, each as ``key: message``."""
    try:
        cls = registry.get(name)
    except UnknownName as error:
        yield f"model: {error}"
        return
    kinds = kinds_of(cls)
    yield from _value_errors(name, kinds, parameters)
    for field in dataclasses.fields(cls):
        missing = field.default is dataclasses.MISSING and field.name in kinds
        if missing and field.name not in parameters:
            yield f"parameters.{field.name}: this key is missing"


def _value_errors(
    name: str, kinds: Mapping[str, type], parameters: Mapping[str, Parameter]
) -> Iterator[str]:
    for key, value in parameters.items():
        if key not in kinds:
            yield f"parameters.{key}: {unknown(f'parameter of {name}', key, list(kinds))}"
        elif not _fits(value, kinds[key]):
            shown = f"{value:g}" if type(value) is float else repr(value)[:60]
            yield f"parameters.{key}: found {shown}, expected {KINDS[kinds[key]]}"


KINDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a word",
    tuple: "a list of numbers, or of lists of them",
}


def _fits(value: Parameter, kind: type) -> bool:
    if kind in (int, float) and isinstance(value, int | float):
        if isinstance(value, bool) or not (kind is float or value == int(value)):
            return False
        # Beyond that a whole number is no 64-bit one, nor sure to be a float.
        return abs(value) < 2**63 or (kind is float and isinstance(value, float))
    return type(value) is (list if kind is tuple else kind)


def _fitting(value: Any, kind: type | None) -> Any:
    if isinstance(value, list):
        return tuple(_fitting(item, None) for item in value)
    if kind in (int, float):
        return kind(value)
    return value
