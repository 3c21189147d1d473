"""Whether a user's own vehicle and sensors return what their contracts say, before a long run.

A slip in a plug-in would come out deep within a filter. Here each method is traced once, by
itself: what it raises is raised in the user's file, and what it returns is compared.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from kedge.config.plugins import place_of
from kedge.core.contracts import AbstractOdeVehicle, AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError


def check_vehicle_plugin(vehicle: AbstractVehicle) -> None:
    """Refuse a vehicle of a user's module whose motion has not the form of its state.

    Raises:
        ContractError: with file and line of the method, what it returns and what was expected.
    """
    cls = type(vehicle)
    if place_of(cls) is None:
        return
    state, noise = vehicle.start(), vehicle.noise_density()
    control, dt = vehicle.nominal_control(jnp.asarray(0.0)), jnp.asarray(0.1)
    if isinstance(vehicle, AbstractOdeVehicle):
        found = eqx.filter_eval_shape(vehicle.rates, state, control, noise)
        _compare(cls, "rates", found, state)
    _compare(cls, "step", eqx.filter_eval_shape(vehicle.step, state, control, noise, dt), state)


def check_sensor_plugins(sensors: Mapping[str, AbstractSensor], state: Any) -> None:
    """Refuse a sensor of a user's module whose readings have not the form of ``measures``.

    Raises:
        ContractError: with file and line of the method, what it returns and what was expected.
    """
    for sensor in sensors.values():
        cls = type(sensor)
        if place_of(cls) is None:
            continue
        one = sensor.for_target(0)
        for method in ("observe", "noise_std"):
            found = eqx.filter_eval_shape(getattr(one, method), one.project(state))
            if type(found) is not sensor.measures:
                raise _wrong(cls, method, type(found).__name__, sensor.measures.__name__)


def _compare(cls: type, method: str, found: Any, expected: Any) -> None:
    if type(found) is not type(expected):
        raise _wrong(cls, method, type(found).__name__, type(expected).__name__)
    for name, value in expected._asdict().items():
        shapes = [jax.tree.map(jnp.shape, tree) for tree in (getattr(found, name), value)]
        if shapes[0] != shapes[1]:
            raise _wrong(cls, method, f"{name} of shape {shapes[0]}", f"{shapes[1]}")


def _wrong(cls: type, method: str, found: str, expected: str) -> ContractError:
    place = place_of(cls, method) or cls.__name__
    return ContractError(
        f"{place}: {cls.__name__}.{method} returns {found}, expected {expected}"
    )
