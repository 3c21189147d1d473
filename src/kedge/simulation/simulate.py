"""Synthetic truth and readings: pure in the key, so a whole study can be one traced program."""

import dataclasses
import zlib
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.estimation.log import (
    SECOND,
    Log,
    Readings,
    Recording,
    Stamped,
    Truth,
    assemble,
)
from kedge.estimation.rig import as_arrays
from kedge.numerics.linalg import square_root
from kedge.numerics.noise import process_std
from kedge.simulation.error_paths import widening_errors, with_error_states
from kedge.simulation.scenario import History, Scenario
from kedge.simulation.sensing import all_sensed, all_told
from kedge.vehicles.augmented import Augmented


class Simulation(NamedTuple):
    """One run of a scenario."""

    truth: Any
    """The state at the end of every step; leading axis K."""
    controls: Any
    """The control held during every step, as filters are told of it; leading axis K."""
    readings: tuple[Readings, ...]
    start: Any
    """The state at time 0."""


def simulate(scenario: Scenario, key: PRNGKeyArray) -> Simulation:
    """Draw a true initial state, drive it or let its world do so, and sense it.

    A pure function of the key: ``jax.vmap(lambda key: simulate(scenario, key))(keys)`` are many
    runs, each the same as by itself; :func:`with_readings` makes a log of one, also in a trace.
    """
    return _simulate(as_arrays(scenario), key)


def fault_key(key: PRNGKeyArray) -> PRNGKeyArray:
    """The key of a run's faults: apart from all that the run draws without any."""
    return jr.fold_in(key, zlib.crc32(b"faults"))


def schedule(scenario: Scenario, output_rate: float = 10.0) -> Recording:
    """The events of a scenario; all its runs share them. The readings in it are blanks."""
    key = jr.key(0)
    # Whatever a guidance hears changes no shape.
    plain = dataclasses.replace(scenario, feedback="none", loop_filter=None)
    shapes = jax.eval_shape(lambda: _simulate(as_arrays(plain), key))
    blank: Simulation = jax.tree.map(lambda leaf: np.zeros(leaf.shape), shapes)
    stamps = np.round(np.arange(scenario.steps) * scenario.dt * SECOND).astype(np.int64)
    end = round(scenario.steps * scenario.dt * SECOND)
    sources = [
        Stamped(
            np.round(scenario.ticks(sensor) * scenario.dt * SECOND).astype(np.int64),
            readings,
        )
        for sensor, readings in zip(scenario.rig.sensors, blank.readings, strict=True)
    ]
    return assemble(0, end, stamps, blank.controls, sources, output_rate)


def record(
    scenario: Scenario, key: PRNGKeyArray, output_rate: float = 10.0
) -> tuple[Recording, Truth]:
    """One run of a scenario as a recording with its truth, like one read from files."""
    plan, run = schedule(scenario, output_rate), simulate(scenario, key)
    ends = np.arange(1, scenario.steps + 1) * scenario.dt
    fields = {name: np.asarray(leaf) for name, leaf in run.truth._asdict().items()}
    return plan._replace(log=with_readings(plan.log, scenario, run)), Truth(ends, fields)


def with_readings(log: Log, scenario: Scenario, run: Simulation) -> Log:
    """A scenario's log with the controls and readings of one run; the schedule stays shared."""
    before = jnp.concatenate([jnp.zeros(1), log.schedule.time[:-1]])
    step = jnp.floor(before / scenario.dt + 1e-6).astype(int)
    held = jnp.clip(step, 0, scenario.steps - 1)
    controls = jax.tree.map(lambda leaf: leaf[held], run.controls)
    return log._replace(controls=controls, readings=run.readings)


@eqx.filter_jit
def _simulate(scenario: Scenario, key: PRNGKeyArray) -> Simulation:
    rig = scenario.rig
    start_key, drive_key, sense_key, filter_key = jr.split(key, 4)
    pilot = scenario.loop_filter
    if pilot is not None and pilot.key is None:
        pilot = dataclasses.replace(pilot, key=filter_key)
        scenario = dataclasses.replace(scenario, loop_filter=pilot)
    if scenario.faults:
        scenario = dataclasses.replace(scenario, fault_key=fault_key(key))
    keys = jr.split(sense_key, max(len(rig.sensors), 1))
    ticks = [scenario.ticks(sensor) for sensor in rig.sensors]
    sensing = tuple(jr.split(k, len(t)) for k, t in zip(keys, ticks, strict=False))
    if scenario.world is None:
        history = _own(scenario, start_key, drive_key)
    else:
        history = scenario.world.unfold(scenario, drive_key, sensing)
    dt = scenario.dt
    # Apart from all other draws, so that a run with errors is the same run.
    error_keys = [jr.fold_in(k, zlib.crc32(b"errors")) for k in keys]
    for sensor, error_key in zip(rig.sensors, error_keys, strict=False):
        history = with_error_states(history, sensor, dt, error_key)
    readings = tuple(
        all_sensed(
            sensor, fired, keys, history, dt, scenario.drawn_faults(sensor),
            widening_errors(sensor, scenario.steps, dt, error_key),
        )
        for sensor, fired, keys, error_key in zip(
            rig.sensors, ticks, sensing, error_keys, strict=False
        )
    )  # fmt: skip
    reported = all_told(history.controls, dt, scenario.drawn_faults(None))
    ends = jnp.arange(1, scenario.steps + 1) * dt
    path = jax.vmap(lambda state, time: _as_estimated(scenario, state, time))(
        history.path, ends
    )
    start = _as_estimated(scenario, history.start, jnp.zeros(()))
    return Simulation(path, reported, readings, start)


def _own(scenario: Scenario, start_key: PRNGKeyArray, drive_key: PRNGKeyArray) -> History:
    """The rig's own vehicle, from its prior, on its own drive."""
    vehicle, prior = scenario.rig.vehicle, scenario.rig.prior
    states, noises = space(prior.mean), space(vehicle.noise_density())
    before = round(scenario.spin_up / scenario.dt)
    start_key, spin_key = jr.split(start_key) if before else (start_key, start_key)
    white = jr.normal(start_key, (states.size,))
    first = states.boxplus(prior.mean, square_root(prior.cov) @ white)

    def drive(state: Any, begin: int, end: int, key: PRNGKeyArray) -> tuple[Any, Any, Any]:
        """The state at the end of every step from ``begin`` to ``end``, and the controls."""
        times = jnp.arange(begin, end) * scenario.dt
        controls = jax.vmap(vehicle.nominal_control)(times)
        shocks = jr.normal(key, (end - begin, noises.size))
        shocks = shocks * process_std(vehicle, scenario.dt)[None]

        def body(state, inputs):
            time, control, noise = inputs
            state = _true(scenario, time).step(
                state, control, noises.unflatten(noise), scenario.dt
            )
            return state, state

        last, path = lax.scan(body, state, (times, controls, shocks))
        return last, path, controls

    if before:
        first, _, _ = drive(first, -before, 0, spin_key)
    _, path, controls = drive(first, 0, scenario.steps, drive_key)
    return History(path, controls, first)


def _true(scenario: Scenario, time: Scalar) -> AbstractVehicle:
    """The rig's vehicle as it really is then, with its augmented states."""
    known, true = scenario.rig.vehicle, scenario.vehicle_at(time)
    if isinstance(known, Augmented):
        return eqx.tree_at(lambda augmented: augmented.vehicle, known, true)
    return true


def _as_estimated(scenario: Scenario, truth: Any, time: Scalar) -> Any:
    """The true state with the fields of the rig's, for scores; what it has beyond is dropped.

    An augmented parameter of the vehicle, if its world says nothing of it, is what the vehicle
    that really moves has then.

    Raises:
        ContractError: the world's truth lacks a field that the rig estimates.
    """
    cls, vehicle = type(scenario.rig.prior.mean), scenario.vehicle_at(time)
    known = {name: jnp.asarray(getattr(truth, name)) for name in type(truth)._fields}
    for name in cls._fields:
        if name not in known and hasattr(vehicle, name):
            known[name] = jnp.asarray(getattr(vehicle, name), float)
    if lacking := [field for field in cls._fields if field not in known]:
        raise ContractError(
            f"scenario: the rig estimates {lacking}, of which its world knows nothing; the "
            f"truth has {list(type(truth)._fields)}"
        )
    return cls(*(known[field] for field in cls._fields))
