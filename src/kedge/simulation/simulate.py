"""Synthetic truth and readings: pure in the key, so a whole study can be one traced program."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax
from jaxtyping import Array, Int, PRNGKeyArray

from kedge.core.manifolds import space
from kedge.estimation.log import (
    SECOND,
    Log,
    Readings,
    Recording,
    Stamped,
    Truth,
    assemble,
)
from kedge.estimation.rig import Installation, as_arrays
from kedge.numerics.linalg import square_root
from kedge.numerics.noise import process_std
from kedge.simulation.scenario import Scenario


class Simulation(NamedTuple):
    """One run of a scenario."""

    truth: Any
    """The state at the end of every step; leading axis K."""
    controls: Any
    """The control held during every step; leading axis K."""
    readings: tuple[Readings, ...]


def simulate(scenario: Scenario, key: PRNGKeyArray) -> Simulation:
    """Draw a true initial state from the prior, drive it, and sense it."""
    return _simulate(as_arrays(scenario), key)


def schedule(scenario: Scenario, output_rate: float = 10.0) -> Recording:
    """The events of a scenario; all its runs share them. The readings in it are blanks."""
    key = jr.key(0)
    shapes = jax.eval_shape(lambda: _simulate(as_arrays(scenario), key))
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
    vehicle, prior = scenario.rig.vehicle, scenario.rig.prior
    states, noises = space(prior.mean), space(vehicle.noise_density())
    start_key, drive_key, sense_key = jr.split(key, 3)
    white = jr.normal(start_key, (states.size,))
    first = states.boxplus(prior.mean, square_root(prior.cov) @ white)

    times = jnp.arange(scenario.steps) * scenario.dt
    controls = jax.vmap(vehicle.drive)(times)
    shocks = jr.normal(drive_key, (scenario.steps, noises.size))
    shocks = shocks * process_std(vehicle, scenario.dt)[None]

    def body(state, inputs):
        control, noise = inputs
        state = vehicle.step(state, control, noises.unflatten(noise), scenario.dt)
        return state, state

    _, path = lax.scan(body, first, (controls, shocks))
    keys = jr.split(sense_key, max(len(scenario.rig.sensors), 1))
    readings = tuple(
        _sense(sensor, scenario.ticks(sensor), key, path)
        for sensor, key in zip(scenario.rig.sensors, keys, strict=False)
    )
    return Simulation(path, controls, readings)


def _sense(
    installation: Installation, ticks: Int[np.ndarray, " n"], key: PRNGKeyArray, path: Any
) -> Readings:
    seen = jax.tree.map(lambda leaf: leaf[ticks - 1], path)
    targets = jnp.arange(len(ticks)) % (installation.targets or 1)

    def one(state: Any, target: Int[Array, ""], key: PRNGKeyArray) -> Any:
        expected = installation.expect(state, target)
        outputs = space(expected)
        root = square_root(installation.noise_cov(state, target))
        return outputs.boxplus(expected, root @ jr.normal(key, (outputs.size,)))

    return Readings(jax.vmap(one)(seen, targets, jr.split(key, len(ticks))), targets)
