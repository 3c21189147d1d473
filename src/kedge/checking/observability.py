"""Which directions of the state a log could determine, and which it could not."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.checking.program import Evaluated
from kedge.checking.setting import Setting
from kedge.core.manifolds import space, space_of
from kedge.estimation.reading import bind_reading

LEAST = 1.0
"""Information of a log, in that of the prior, below which it has told hardly anything."""
SHARE = 0.3
"""Part of a direction from which on a component is named."""


class Direction(NamedTuple):
    """A direction of the state about which the log says less than the prior does."""

    components: tuple[str, ...]
    information: float
    """Of the log, in that of the prior: 0 is none at all."""


def undetermined(setting: Setting, evaluated: Evaluated) -> list[Direction]:
    r"""Singular directions of the information that the readings bring about the first state.

    $J = \sum_k \Phi_k^\top H_k^\top R_k^{-1} H_k \Phi_k$ along the estimated path, with
    $\Phi_k$ from the start to reading k, in standard deviations of the prior.

    Source: A. Gelb (ed.), "Applied Optimal Estimation", 1974, section 3.5 (observability).
    """
    schedule, mean = evaluated.log.schedule, setting.rig.prior.mean
    states = space(mean)
    paths = jax.tree.map(
        lambda first, later: jnp.concatenate([jnp.asarray(first)[None], jnp.asarray(later)]),
        mean,
        evaluated.estimates.moments.mean,
    )
    before = jax.tree.map(lambda leaf: leaf[:-1], paths)
    after = jax.tree.map(lambda leaf: leaf[1:], paths)
    time = np.asarray(schedule.time)
    steps = jnp.asarray(np.diff(time, prepend=0.0))
    F = np.asarray(_transitions(setting.rig.vehicle, before, evaluated.log.controls, steps))
    sensor, row = np.asarray(schedule.sensor), np.asarray(schedule.row)
    information = np.zeros((len(time), states.size, states.size))
    for place, installation in enumerate(setting.rig.sensors):
        at = np.flatnonzero(
            (sensor == place) & (np.asarray(evaluated.estimates.outcome.dof) > 0)
        )
        if len(at):
            states_then = jax.tree.map(lambda leaf, at=at: leaf[at], after)
            readings = jax.tree.map(
                lambda leaf, at=at: jnp.asarray(leaf)[row[at]], evaluated.log.readings[place]
            )
            information[at] = np.asarray(_information(installation, states_then, readings))
    total = np.zeros((states.size,) * 2)
    from_start = np.eye(states.size)
    for transition, brought in zip(F, information, strict=True):
        from_start = transition @ from_start
        if brought.any():
            total += from_start.T @ brought @ from_start
    std = np.sqrt(np.asarray(setting.rig.prior.cov).diagonal())
    values, vectors = np.linalg.eigh(np.nan_to_num(total) * np.outer(std, std))
    return [
        Direction(_named(states.labels, vectors[:, i]), float(max(values[i], 0.0)))
        for i in range(states.size)
        if values[i] < LEAST and (std[np.abs(vectors[:, i]) > SHARE] > 0).any()
    ]


def _named(labels: tuple[str, ...], vector: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    return tuple(label for label, part in zip(labels, vector, strict=True) if abs(part) > SHARE)


@eqx.filter_jit
def _transitions(vehicle: Any, states: Any, controls: Any, steps: Any) -> Float[Array, "T n n"]:
    def one(state: Any, control: Any, dt: Any) -> Any:
        tangent = space(state)
        still = jax.tree.map(jnp.zeros_like, vehicle.noise_density())

        def stepped(error: Any) -> Any:
            return vehicle.step(tangent.boxplus(state, error), control, still, dt)

        ahead = stepped(tangent.zeros())
        slope = jax.jacfwd(lambda e: tangent.boxminus(stepped(e), ahead))(tangent.zeros())
        return jnp.where(dt > 0, slope, jnp.eye(tangent.size))

    return jax.vmap(one)(states, controls, steps)


@eqx.filter_jit
def _information(installation: Any, states: Any, readings: Any) -> Float[Array, "T n n"]:
    outputs = space_of(installation.sensor.measures)

    def one(state: Any, reading: Any) -> Any:
        model, _ = bind_reading(installation, reading)
        tangent, expected = space(state), model.expect(state)
        H = jax.jacfwd(
            lambda e: outputs.boxminus(model.expect(tangent.boxplus(state, e)), expected)
        )(tangent.zeros())
        return H.T @ jnp.linalg.solve(model.noise_cov(state), H)

    return jax.vmap(one)(states, readings)
