"""Rigs whose sensors have errors with a memory: the states that these errors are."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.manifolds import Chart, Euclidean, charts_of, space
from kedge.core.quantities import Scalar
from kedge.estimation.correlated_error import state_field
from kedge.estimation.rig import Installation, Rig
from kedge.vehicles.augmented import Augmented, GaussMarkov, carrying

Values = Scalar | Float[Array, " m"]


class ErrorState(NamedTuple):
    """The errors of one field of a sensor's measurement, of all targets."""

    chart: Chart
    process: GaussMarkov
    std: Float[Array, " k"]


def with_errors(rig: Rig) -> Rig:
    """The rig with the errors of its sensors in its vehicle's state and in its prior.

    They begin at zero with their standard deviation, which they keep. Those that are in the
    state already stay as they are.

    Raises:
        ContractError: an error does not fit what its sensor measures.
    """
    states: dict[str, ErrorState] = {}
    considered: list[str] = []
    has = charts_of(type(rig.prior.mean))
    for installation in rig.sensors:
        fresh = {n: s for n, s in error_states(installation).items() if n not in has}
        states |= fresh
        if installation.error is not None and installation.error.treatment == "considered":
            considered += fresh
    if not states:
        return rig
    processes = {name: (state.chart, state.process) for name, state in states.items()}
    vehicle = carrying(rig.vehicle, processes, considered)
    mean = vehicle.start()
    fields = rig.prior.mean._asdict()
    mean = mean._replace(**fields)
    size = space(rig.prior.mean).size
    cov = jnp.zeros((space(mean).size,) * 2).at[:size, :size].set(rig.prior.cov)
    prior = _with_spreads(Gaussian(mean, cov), states)
    return dataclasses.replace(rig, vehicle=vehicle, prior=prior)


def with_error(rig: Rig, sensor: str, std: Values, time_constant: Values) -> Rig:
    """The rig with other parameters of the error of a sensor that has one; traceable.

    Raises:
        ContractError: there is no such sensor, or it has no error with a memory.
    """
    place = rig.index(sensor)
    installation = rig.sensors[place]
    if installation.error is None:
        raise ContractError(f"sensor {sensor!r} has no error with a memory")
    error = dataclasses.replace(installation.error, std=std, time_constant=time_constant)
    installation = dataclasses.replace(installation, error=error)
    sensors = (*rig.sensors[:place], installation, *rig.sensors[place + 1 :])
    states = error_states(installation)
    vehicle = rig.vehicle
    if states and isinstance(vehicle, Augmented):
        processes = {name: state.process for name, state in states.items()}
        vehicle = dataclasses.replace(vehicle, augmented=vehicle.augmented | processes)
    prior = _with_spreads(rig.prior, states)
    return dataclasses.replace(rig, vehicle=vehicle, sensors=sensors, prior=prior)


def error_states(installation: Installation) -> Mapping[str, ErrorState]:
    """By the field's name in the state, the errors of a sensor that are states.

    Raises:
        ContractError: not one value, nor one for each component measured; or none above 0.
    """
    error = installation.error
    if error is None:
        return {}
    measured = charts_of(installation.sensor.measures)
    sizes = [chart.size for chart in measured.values()]
    std = _values(installation, "std", error.std, sum(sizes))
    tau = _values(installation, "time_constant", error.time_constant, sum(sizes))
    if not error.is_state:
        return {}
    targets = (installation.targets or 1) if error.by_target else 1
    states, cuts = {}, np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    for (field, chart), cut in zip(measured.items(), cuts, strict=True):
        spread, decay = std[cut], tau[cut]
        if not isinstance(spread, Tracer) and not np.any(np.asarray(spread)):
            continue
        every, memory = jnp.tile(spread, targets), jnp.tile(decay, targets)
        walk = every * jnp.sqrt(2 / memory)
        shape = (targets * chart.size,)
        process = GaussMarkov(jnp.zeros(shape), walk, memory)
        name = state_field(installation.name, field)
        states[name] = ErrorState(Euclidean(chart.unit, shape), process, every)
    return states


def _values(installation: Installation, key: str, given: Any, size: int) -> Float[Array, " m"]:
    if np.shape(given) not in ((), (1,), (size,)):
        parts = charts_of(installation.sensor.measures)
        raise ContractError(
            f"sensors.{installation.name}.error.{key}: found {np.size(given)} numbers, "
            f"expected 1 or {size}: it measures {', '.join(parts)}"
        )
    values = jnp.broadcast_to(jnp.asarray(given, float), (size,))
    if not isinstance(values, Tracer):
        each, name = np.asarray(values), f"sensors.{installation.name}.error.{key}"
        spread = np.isfinite(each).all() and each.min() >= 0 and each.any()
        if key == "std" and not spread:
            raise ContractError(f"{name} is {each.tolist()}, expected 0 or more, one above 0")
        if key == "time_constant" and not (each > 0).all():
            raise ContractError(f"{name} is {each.tolist()}, expected above 0 s")
    return values


def _with_spreads(prior: Gaussian, states: Mapping[str, ErrorState]) -> Gaussian:
    cov = prior.cov
    for name, cut in space(prior.mean).slices().items():
        if name in states:
            cov = cov.at[cut, cut].set(jnp.diag(states[name].std ** 2))
    return Gaussian(prior.mean, cov)
