"""What a help page, a form or a program needs to know about a registered class."""

import dataclasses
from typing import Any, get_type_hints

import numpy as np

from kedge.config.filters import parameters_of
from kedge.core import registry
from kedge.core.contracts import AbstractFilter, AbstractSensor, AbstractVehicle
from kedge.core.manifolds import charts_of, space, space_of


def describe(cls: type) -> dict[str, Any]:
    """First sentence, parameters with default and unit, and the components it speaks of."""
    about: dict[str, Any] = {
        "summary": (cls.__doc__ or "").strip().splitlines()[0],
        "parameters": parameters(cls),
    }
    if issubclass(cls, AbstractVehicle):
        vehicle = cls()
        about["state"] = components(vehicle.start())
        about["control"] = components(vehicle.nominal_control(0.0))
        about["noise"] = components(vehicle.noise_density())
    if issubclass(cls, AbstractSensor):
        optional = cls.reads._field_defaults
        units = {name: chart.unit for name, chart in charts_of(cls.reads).items()}
        about["reads"] = {n: u for n, u in units.items() if n not in optional}
        about["reads_if_present"] = {n: u for n, u in units.items() if n in optional}
        measured = space_of(cls.measures)
        about["measurement"] = dict(zip(measured.labels, measured.units, strict=True))
    return about


def parameters(cls: Any) -> dict[str, dict[str, Any]]:
    """Name to default and unit, for every parameter that a rig can set."""
    hints = get_type_hints(cls, include_extras=True)
    parameters = {}
    typed = parameters_of(cls) if issubclass(cls, AbstractFilter) else {}
    for field in dataclasses.fields(cls):
        default = field.default
        if isinstance(default, AbstractFilter):
            default = registry.filters.name_of(type(default))
        if isinstance(default, (int, float, str, np.ndarray)) or field.name in typed:
            metadata = getattr(hints.get(field.name), "__metadata__", ())
            unit = next((m.unit for m in metadata if hasattr(m, "boxplus")), "")
            parameters[field.name] = {"default": default, "unit": unit}
    return parameters


def components(value: Any) -> dict[str, str]:
    """Component labels of a state, control or noise, with their units."""
    of = space(value)
    return dict(zip(of.labels, of.units, strict=True))


def registered(family: str) -> dict[str, dict[str, Any]]:
    """All members of a family of models: "vehicles", "worlds", and so on."""
    family_registry = getattr(registry, family)
    return {name: describe(family_registry.get(name)) for name in family_registry.names()}
