"""Readings of a true state: one function, for recorded readings and for those in a loop."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from kedge.core.manifolds import space
from kedge.estimation.log import Readings
from kedge.estimation.rig import Installation
from kedge.numerics.noise import coloured
from kedge.simulation.faults import DrawnFault, all_changed, lags
from kedge.simulation.scenario import History


def sensed(
    installation: Installation, state: Any, target: Int[Array, ""], key: PRNGKeyArray
) -> Any:
    """What a sensor measures of one target from a true state."""
    installation = as_it_is(installation)
    expected = installation.expect(state, target)
    outputs = space(expected)
    noise = coloured(
        jr.normal(key, (outputs.size,)),
        installation.noise_variance(state, target),
        lambda: installation.noise_cov(state, target),
    )
    return outputs.boxplus(expected, noise)


def as_it_is(installation: Installation) -> Installation:
    """With the sensor that is simulated, where filters take it for another."""
    if installation.true_sensor is None:
        return installation
    return dataclasses.replace(installation, sensor=installation.true_sensor, true_sensor=None)


def targets_of(installation: Installation, count: int) -> Int[Array, " n"]:
    """The target of each reading: all of the map in turn."""
    return jnp.arange(count) % (installation.targets or 1)


def all_sensed(
    installation: Installation,
    ticks: Any,
    keys: Key[Array, " n"],
    history: History,
    dt: float,
    drawn_faults: Sequence[DrawnFault] = (),
    errors: Float[Array, "K targets m"] | None = None,
) -> Readings:
    """All readings of a sensor; ``ticks`` are the steps, from 1, at whose ends it fires.

    ``errors`` at the ends of all steps are added, for all targets or for each.
    """
    late, targets = lags(drawn_faults), targets_of(installation, len(ticks))
    if late is None:
        seen = jax.tree.map(lambda leaf: leaf[ticks - 1], history.path)
    else:
        seen = jax.vmap(lambda time: _between(history, time))(ticks - late / dt)

    def one(state: Any, target: Int[Array, ""], key: PRNGKeyArray) -> Any:
        return sensed(installation, state, target, key)

    measured = jax.vmap(one)(seen, targets, keys)
    if errors is not None:
        of_each = errors[ticks - 1, targets % errors.shape[1]]
        measured = jax.vmap(space(measured).boxplus)(measured, of_each)
    if drawn_faults:
        stds = jax.vmap(lambda *where: noise_std(installation, *where))(seen, targets)
        measured, targets = all_changed(drawn_faults, measured, stds, targets)
    return Readings(measured, targets)


def all_told(controls: Any, dt: float, drawn_faults: Sequence[DrawnFault]) -> Any:
    """The controls of every step as filters are told of them; what is lost, they hold on."""
    if not drawn_faults:
        return controls
    outputs, steps = space(controls), len(jax.tree.leaves(controls)[0])
    late = lags(drawn_faults)
    if late is not None:
        step = jnp.floor(jnp.arange(steps) - late / dt + 1e-6).astype(int)
        controls = jax.tree.map(lambda leaf: leaf[jnp.clip(step, 0, steps - 1)], controls)
    controls = jax.tree.map(lambda leaf: 1.0 * leaf, controls)
    reported, _ = all_changed(drawn_faults, controls, jnp.ones((steps, outputs.size)))
    return jax.tree.map(_held, reported)


def noise_std(installation: Installation, state: Any, target: Any) -> Float[Array, " m"]:
    """The standard deviation of each component of a reading."""
    installation = as_it_is(installation)
    variance = installation.noise_variance(state, target)
    if variance is None:
        variance = jnp.diag(installation.noise_cov(state, target))
    return jnp.sqrt(variance)


def _between(history: History, step: Float[Array, ""]) -> Any:
    """The true state after so many steps and a part of one; the ends of the run go on."""
    states, count = space(history.path), len(jax.tree.leaves(history.path)[0])
    step = jnp.clip(step, 0.0, count)
    before = jnp.minimum(jnp.floor(step), count - 1).astype(int)

    def at(number: Int[Array, ""]) -> Any:
        def pick(first: Array, later: Array) -> Array:
            return jnp.where(number == 0, first, later[jnp.maximum(number - 1, 0)])

        return jax.tree.map(pick, history.start, history.path)

    one, other = at(before), at(before + 1)
    return states.boxplus(one, (step - before) * states.boxminus(other, one))


def _held(values: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """Where something is missing, what stood before; at the beginning, what came first."""
    gaps = jnp.isnan(values).reshape(len(values), -1).any(axis=1)
    number = jnp.arange(len(values))
    latest = lax.cummax(jnp.where(gaps, -1, number))
    source = jnp.where(latest < 0, jnp.argmin(gaps), latest)
    return jnp.nan_to_num(values[source])
