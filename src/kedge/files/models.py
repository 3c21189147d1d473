"""Registered models as files name them: their numbers and the parts of their fields."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from kedge.core.manifolds import Chart, charts_of


def parameters_of(cls: type) -> dict[str, int | float]:
    """The numbers that a model can be built with, and their defaults."""
    return {
        field.name: field.default
        for field in dataclasses.fields(cls)
        if isinstance(field.default, int | float) and not isinstance(field.default, bool)
    }


def build_model(cls: type, parameters: Mapping[str, float], **others: Any) -> Any:
    """An instance; numbers from a file become whole where the model's own are."""
    known = parameters_of(cls)
    whole = {key: int(v) for key, v in parameters.items() if isinstance(known.get(key), int)}
    return cls(**(dict(parameters) | whole), **others)


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
