"""One event: advance to its time, then use its reading. Batch and online share it."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from kedge.core.contracts import AbstractFilter, AbstractVehicle
from kedge.core.manifolds import space_of
from kedge.core.quantities import Scalar
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Readings
from kedge.estimation.reading import is_positive_definite, sight
from kedge.estimation.rig import Installation
from kedge.filters.gated import Gated
from kedge.filters.robust import Robust
from kedge.numerics.linalg import cholesky, solve_lower

B = TypeVar("B")


class Outcome(NamedTuple):
    """What became of an event's reading; padded with NaN to the largest measurement."""

    verdict: Int[Array, "*T"]
    residual: Float[Array, "*T m"]
    std: Float[Array, "*T m"]
    """Standard deviation of the residual as predicted."""
    white: Float[Array, "*T m"]
    """The residual divided by the root of its covariance: white and of unit variance."""
    nis: Float[Array, "*T"]
    dof: Int[Array, "*T"]
    threshold: Float[Array, "*T"]
    log_likelihood: Float[Array, "*T"]


def advance(
    filter: AbstractFilter[B],
    vehicle: AbstractVehicle,
    belief: B,
    control: Any,
    dt: Scalar,
    key: PRNGKeyArray,
) -> B:
    """Predict by ``dt`` seconds; an event at the same time as the last one is free."""
    return lax.cond(
        dt > 0,
        lambda: filter.predict(vehicle, belief, control, dt, key),
        lambda: belief,
    )


def condition(
    filter: AbstractFilter[B],
    sensors: Sequence[Installation],
    belief: B,
    readings: Sequence[Readings],
    sensor: Int[Array, ""],
    row: Int[Array, ""],
    key: PRNGKeyArray,
) -> tuple[B, Outcome]:
    """Update with the sensor that fired; without one (-1) nothing changes."""
    width = widest(sensors)

    def no_reading():
        return belief, silence(width)

    def branch(installation, rows):
        if len(rows.target) == 0:  # it never fires, and there is no row to look at
            return no_reading

        def use():
            reading = jax.tree.map(lambda leaf: leaf[row], rows)
            return take_in(filter, installation, belief, reading, key, width)

        return use

    branches = [no_reading, *map(branch, sensors, readings)]
    return lax.switch(sensor + 1, branches)


def take_in(
    filter: AbstractFilter[B],
    installation: Installation,
    belief: B,
    reading: Readings,
    key: PRNGKeyArray,
    width: int,
) -> tuple[B, Outcome]:
    """Use one reading if it is fit to be used, and say what became of it."""
    chosen: AbstractFilter = filter
    if installation.student_dof is not None:
        chosen = Robust(chosen, installation.student_dof)
    if installation.gate is not None:
        chosen = Gated(chosen, installation.gate)
    model, measurement = sight(installation, reading)
    posterior, score = chosen.update(model, belief, measurement, key)

    verdict = jnp.asarray(Verdict.FUSED)

    def unless(good: Bool[Array, ""], otherwise: Verdict) -> None:
        nonlocal verdict
        verdict = jnp.where(good, verdict, otherwise)

    # In rising order of importance: the last reason that applies is the verdict.
    unless(jnp.asarray(score.accepted), Verdict.DROPPED)
    unless(score.nis <= score.threshold, Verdict.GATED)
    unless(_finite(posterior) & ~jnp.isnan(score.nis), Verdict.NOT_FINITE)
    if reading.cov is not None:
        unless(is_positive_definite(model.noise_cov(None)), Verdict.BAD_COVARIANCE)
    infinite = [jnp.isinf(leaf).any() for leaf in jax.tree.leaves(reading.measurement)]
    unless(model.present.any() & ~jnp.stack(infinite).any(), Verdict.NOT_FINITE)
    unless(installation.knows(reading.target), Verdict.UNKNOWN_TARGET)

    fused = verdict == Verdict.FUSED
    kept = jax.tree.map(lambda new, old: jnp.where(fused, new, old), posterior, belief)

    size = space_of(installation.sensor.measures).size
    judged = fused | (verdict == Verdict.GATED) | (verdict == Verdict.DROPPED)
    shown = model.present & judged
    pad = jnp.full(width - size, jnp.nan)

    def padded(values):
        return jnp.concatenate([jnp.where(shown, values, jnp.nan), pad])

    def known(value):
        return jnp.where(judged, value, jnp.nan)

    outcome = Outcome(
        verdict=verdict,
        residual=padded(score.residual),
        std=padded(jnp.sqrt(jnp.diag(score.cov))),
        white=padded(solve_lower(cholesky(score.cov), score.residual)),
        nis=known(score.nis),
        dof=jnp.where(judged, score.dof, 0),
        threshold=jnp.where(judged, score.threshold, jnp.inf),
        log_likelihood=jnp.where(fused, score.log_likelihood, 0.0),
    )
    return kept, outcome


def silence(width: int) -> Outcome:
    """The outcome of an event without a reading."""
    gap, nothing = jnp.full(width, jnp.nan), jnp.asarray(jnp.nan)
    return Outcome(
        verdict=jnp.asarray(Verdict.NONE),
        residual=gap,
        std=gap,
        white=gap,
        nis=nothing,
        dof=jnp.asarray(0),
        threshold=jnp.asarray(jnp.inf),
        log_likelihood=jnp.asarray(0.0),
    )


def widest(sensors: Sequence[Installation]) -> int:
    """Size of the largest measurement, to which outcomes are padded."""
    return max((space_of(s.sensor.measures).size for s in sensors), default=0)


def event_keys(
    key: PRNGKeyArray, index: Int[Array, ""] | int
) -> tuple[PRNGKeyArray, PRNGKeyArray]:
    """Prediction and update keys of event ``index``, counted from 1; 0 is the prior.

    ``key`` itself is never used to draw, so no key is used twice.
    """
    predict, update = jr.split(jr.fold_in(key, index))
    return predict, update


def _finite(tree: Any) -> Bool[Array, ""]:
    leaves = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(tree)]
    return jnp.stack(leaves).all()
