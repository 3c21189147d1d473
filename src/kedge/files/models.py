"""Registered models as files name them: their numbers, the parts of their fields, filters."""

import ast
import dataclasses
from typing import Any

from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ConfigError, ContractError
from kedge.core.manifolds import Chart, charts_of
from kedge.core.registry import filters, unknown


def parameters_of(cls: type) -> dict[str, int | float]:
    """The numbers that a model can be built with, and their defaults."""
    return {
        field.name: field.default
        for field in dataclasses.fields(cls)
        if isinstance(field.default, int | float) and not isinstance(field.default, bool)
    }


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


def build_filter(spec: str) -> AbstractFilter:
    """A filter from what is typed: ``extended`` or ``particle:count=5000,threshold=0.3``.

    Raises:
        UnknownName: there is no such filter.
        ConfigError: a parameter is unknown, of the wrong type or refused by the filter.
    """
    name, _, rest = spec.partition(":")
    cls = filters.get(name.strip())
    known, given = parameters_of(cls), {}
    for item in rest.split(",") if rest.strip() else ():
        key, equals, text = (part.strip() for part in item.partition("="))
        if not equals:
            raise ConfigError(f"filter {spec!r}: found {item!r}, expected PARAMETER=VALUE")
        if key not in known:
            raise ConfigError(
                f"filter {spec!r}: {unknown(f'parameter of {name}', key, list(known))}"
            )
        if key in given:
            raise ConfigError(f"filter {spec!r}: found {key!r} twice, expected it once")
        given[key] = _number(spec, key, text, type(known[key]))
    try:
        return cls(**given)
    except ContractError as error:
        raise ConfigError(f"filter {spec!r}: {error}") from error


def _number(spec: str, key: str, text: str, kind: type) -> int | float:
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        value = None
    if type(value) is int:
        return kind(value)
    if type(value) is float and kind is float:
        return value
    what = "a whole number" if kind is int else "a number"
    raise ConfigError(f"filter {spec!r}: {key}: found {text!r}, expected {what}")
