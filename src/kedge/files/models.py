"""Registered models as files name them: their numbers and the parts of their fields."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import Field

from kedge.core.errors import UnknownName
from kedge.core.manifolds import Chart, charts_of
from kedge.core.registry import Registry, unknown

Number = Annotated[float, Field(allow_inf_nan=False)]
Parameter = bool | int | Number | str | list[Number] | list[list[Number]]
"""What a model can be built with."""


def kinds_of(cls: type) -> dict[str, type]:
    """What can be set of a model as text: numbers, words, true or false, lists."""
    hints, found = get_type_hints(cls), {}
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        likely = [type(field.default), getattr(hint, "__origin__", hint), *get_args(hint)]
        # A default says its kind; what has none is known by its type.
        kinds = [kind for kind in likely if kind in KINDS]
        if kinds:
            found[field.name] = kinds[0]
    return found


def build_model(cls: type, parameters: Mapping[str, Parameter], **others: Any) -> Any:
    """An instance; numbers from a file become whole where the model's own are."""
    kinds = kinds_of(cls)
    fitting = {key: _fitting(value, kinds.get(key)) for key, value in parameters.items()}
    return cls(**fitting, **others)


def model_complaints(
    registry: Registry, name: str, parameters: Mapping[str, Parameter]
) -> Iterator[str]:
    """Unknown names and values of the wrong kind, each as ``key: message``."""
    try:
        cls = registry.get(name)
    except UnknownName as error:
        yield f"model: {error}"
        return
    kinds = kinds_of(cls)
    yield from _value_complaints(name, kinds, parameters)
    for field in dataclasses.fields(cls):
        missing = field.default is dataclasses.MISSING and field.name in kinds
        if missing and field.name not in parameters:
            yield f"parameters.{field.name}: this key is missing"


def _value_complaints(
    name: str, kinds: Mapping[str, type], parameters: Mapping[str, Parameter]
) -> Iterator[str]:
    for key, value in parameters.items():
        if key not in kinds:
            yield f"parameters.{key}: {unknown(f'parameter of {name}', key, list(kinds))}"
        elif not _fits(value, kinds[key]):
            shown = f"{value:g}" if type(value) in (int, float) else repr(value)
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
        return not isinstance(value, bool) and (kind is float or value == int(value))
    return type(value) is (list if kind is tuple else kind)


def _fitting(value: Any, kind: type | None) -> Any:
    if isinstance(value, list):
        return tuple(_fitting(item, None) for item in value)
    if kind in (int, float):
        return kind(value)
    return value


def parts(field: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """What the components of a field are called: ``position_x``; a scalar is called as it is.

    The names are those of :attr:`kedge.core.manifolds.Space.labels`, except for quaternions,
    whose four components in a file are ``_w``, ``_x``, ``_y``, ``_z``.
    """
    if not shape or shape == (1,):
        return (field,)
    axes = "xyz" if shape[0] <= 3 else map(str, range(shape[0]))
    return tuple(f"{field}_{axis}" for _, axis in zip(range(shape[0]), axes, strict=False))


def columns_of(field: str, chart: Chart) -> tuple[str, ...]:
    """What the columns of a field of a state, control or measurement are called."""
    if chart.shape != chart.tangent_shape:
        return tuple(f"{field}_{axis}" for axis in "wxyz")
    return parts(field, chart.shape)


def components(cls: Any) -> dict[str, str]:
    """Component -> unit of a state, control or measurement, as columns of a file."""
    return {
        name: chart.unit if chart.shape == chart.tangent_shape else "1"
        for field, chart in charts_of(cls).items()
        for name in columns_of(field, chart)
    }
