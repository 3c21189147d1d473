"""One event: predict to its time, then use its reading. Every driver takes these two steps."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from kedge.core.contracts import AbstractFilter, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import considered_of, space_of
from kedge.core.quantities import Scalar
from kedge.core.verdicts import Verdict
from kedge.estimation.correlated_error import new_times
from kedge.estimation.log import REPEATED, Readings
from kedge.estimation.reading import bind_reading, is_positive_definite
from kedge.estimation.recovery import Clocks, new_clocks, recover
from kedge.estimation.rig import Installation, Rig, as_arrays
from kedge.estimation.transition import predict_with_record, still
from kedge.numerics.linalg import cholesky, solve_lower
from kedge.numerics.random import fold_in

B = TypeVar("B")


class FilterState(NamedTuple):
    """All that is carried from event to event, by every driver."""

    belief: Any
    clocks: Clocks | None = None
    """Of the sensors' outliers; None if there is no recovery from them."""
    time: Float[Array, ""] | float = 0.0
    """s; of the newest event."""
    predictions: Int[Array, ""] | int = 0
    """How many there were, and"""
    readings: Int[Array, ""] | int = 0
    """how many readings: the next keys follow from them."""
    behind: Float[Array, ""] | float = 0.0
    """s by which the belief is older than the newest event, since it could not be predicted."""
    fused: tuple[Float[Array, " targets"] | None, ...] | None = None
    """s; of sensors whose errors widen their noise, the last reading fused of each target."""


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
    effective_size: Float[Array, "*T"]
    """Of weighted particles, before resampling; 0 if none explains the reading."""
    resampled: Bool[Array, "*T"]
    repairs: Int[Array, "*T"]
    """Pivots of a covariance that had to be lifted to zero."""
    outlying: Bool[Array, "*T"]
    """Refused by a gate, or weighed down by a robust loss, as an outlier."""
    recovered: Bool[Array, "*T"]
    """An outlier, and let in since there was nothing but outliers for too long."""


def begin(
    filter: AbstractFilter, rig: Rig, key: PRNGKeyArray, time: Scalar = 0.0
) -> FilterState:
    """The prior as the filter's belief, with room for all that it will carry.

    Raises:
        ContractError: states are to be considered, and the filter would estimate them.
    """
    if any(considered_of(type(rig.prior.mean))) and not filter.considers():
        raise ContractError(
            f"{type(filter).__name__} cannot consider errors of sensors: expected a filter "
            "such as 'extended' or 'unscented', or an error with considered = false or "
            "widened = true"
        )
    belief = filter.init(rig.prior, jr.fold_in(key, 0))
    belief = with_room(filter, rig.vehicle, belief)
    clocks, none = new_clocks(filter, rig.sensors), jnp.zeros((), int)
    begun = jnp.asarray(time, float)
    return FilterState(belief, clocks, begun, none, none, jnp.zeros(()), new_times(rig.sensors))


def with_room(filter: AbstractFilter[B], vehicle: AbstractVehicle, belief: B) -> B:
    """Zeros where a fresh belief has None and a predicted one has numbers.

    What a scan carries has one structure throughout, but some of it can only be told from the
    vehicle, which a filter first meets when it predicts.
    """

    def is_gap(leaf: Any) -> bool:
        return leaf is None

    if not any(map(is_gap, jax.tree.leaves(belief, is_leaf=is_gap))):
        return belief
    control = as_arrays(vehicle.nominal_control(0.0))
    predicted = jax.eval_shape(
        lambda key: filter.predict(vehicle, belief, control, jnp.ones(()), key), jr.key(0)
    )

    def fill(value: Any, later: Any) -> Any:
        if value is not None:
            return value
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), later)

    return jax.tree.map(fill, belief, predicted, is_leaf=is_gap)


def advance(
    filter: AbstractFilter[B],
    vehicle: AbstractVehicle,
    belief: B,
    control: Any,
    dt: Scalar,
    key: PRNGKeyArray,
    moves: Bool[Array, ""] | None = None,
) -> B:
    """Predict by ``dt`` seconds; an event at the same time as the last one is free.

    ``moves`` says whether it is later, where all runs of a batch know that and not ``dt``.
    """
    return lax.cond(
        dt > 0 if moves is None else moves,
        lambda: filter.predict(vehicle, belief, control, dt, key),
        lambda: belief,
    )


def predict_to(
    filter: AbstractFilter,
    vehicle: AbstractVehicle,
    state: FilterState,
    control: Any,
    time: Scalar,
    key: PRNGKeyArray,
    record: bool = False,
    dt: Scalar | None = None,
) -> tuple[FilterState, Any]:
    """The state at ``time``; with ``record`` also what a smoother needs of the prediction.

    An event that is older than the state changes nothing. ``dt`` is the time that passes in s,
    for drivers that know it better than as a difference. A prediction that is no belief (not
    finite, or of a negative variance) is not taken: the belief stays as it was, and the next
    prediction is over the whole time since, as far as the vehicle's step stays stable.
    """
    number = state.predictions + jnp.where(time > state.time, 1, 0)
    dt = time - state.time if dt is None else dt
    whole = jnp.where(dt > 0, jnp.minimum(dt + state.behind, _furthest(vehicle, dt)), dt)
    keyed = prediction_key(key, number)
    motion = filter, vehicle, state.belief, control, whole, keyed, jnp.asarray(dt > 0)
    belief, kept = predict_with_record(*motion) if record else (advance(*motion), None)
    sound = is_sound(belief)

    def chosen(new: Any, old: Any) -> Any:
        return jax.tree.map(lambda new, old: jnp.where(sound, new, old), new, old)

    belief = chosen(belief, state.belief)
    kept = chosen(kept, still(filter, state.belief)) if record else None
    missing = jnp.maximum(dt, 0.0) + state.behind
    behind = jnp.where(sound & (dt > 0), missing - whole, missing)
    last = jnp.maximum(time, state.time)
    state = state._replace(belief=belief, time=last, predictions=number, behind=behind)
    return state, kept


def _furthest(vehicle: AbstractVehicle, dt: Scalar) -> Scalar:
    """S to predict at once where something has to be made up for."""
    try:
        return jnp.maximum(dt, vehicle.longest_step())
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError):
        return 2 * jnp.asarray(dt)  # a limit that hangs on parameters, within a trace


def is_sound(belief: Any) -> Bool[Array, ""]:
    """Whether all of a belief is finite, and no variance in it below 0."""
    sound = jnp.asarray(True)
    for path, leaf in jax.tree_util.tree_leaves_with_path(belief):
        sound &= jnp.isfinite(leaf).all()
        if path and getattr(path[-1], "name", "") == "cov":
            sound &= (jnp.diagonal(leaf, axis1=-2, axis2=-1) >= 0).all()
    return sound


def process_scheduled(
    filter: AbstractFilter,
    sensors: Sequence[Installation],
    state: FilterState,
    readings: Sequence[Readings],
    sensor: Int[Array, ""],
    row: Int[Array, ""],
    key: PRNGKeyArray,
) -> tuple[FilterState, Outcome]:
    """Update with the sensor that fired; without one (-1) nothing changes."""
    width = widest(sensors)

    def no_reading():
        return state, silence(width)

    def branch(place, rows):
        if len(rows.target) == 0:  # it never fires, and there is no row to look at
            return no_reading

        def use():
            reading = jax.tree.map(lambda leaf: leaf[row], rows)
            return process_measurement(filter, sensors, place, state, reading, key)

        return use

    branches = [no_reading, *(branch(i, rows) for i, rows in enumerate(readings))]
    return lax.switch(sensor + 1, branches)


def process_measurement(
    filter: AbstractFilter,
    sensors: Sequence[Installation],
    place: int,
    state: FilterState,
    reading: Readings,
    key: PRNGKeyArray,
) -> tuple[FilterState, Outcome]:
    """Use one reading of the sensor at ``place`` if it is fit, and say what became of it.

    It was taken at the state's time; ``key`` is that of the whole run.
    """
    belief, clocks, time = state.belief, state.clocks, state.time
    number = state.readings + 1
    key = reading_key(key, number)
    installation = sensors[place]
    judge = installation.judged(filter)
    model, measurement = bind_reading(installation, reading)
    looked_at, times = jnp.asarray(False), None if state.fused is None else state.fused[place]
    if times is not None and installation.error is not None:
        looked_at = (jnp.arange(len(times)) == reading.target) | (len(times) == 1)
        since = time - jnp.max(jnp.where(looked_at, times, -1e9))
        extra = installation.error.extra_variance(since, model.present.shape[0])
        model = dataclasses.replace(model, extra=extra)
    posterior, score = judge.update(model, belief, measurement, key)
    outlying = jnp.asarray(score.outlying)
    recovered = contradicted = jnp.asarray(False)
    if clocks is not None and math.isfinite(judge.recovery_time()):
        due = outlying & clocks.due(place, time, judge.recovery_time())
        posterior, score, recovered = recover(
            filter, sensors, place, clocks, belief, (posterior, score), model, measurement,
            time, key, due,
        )  # fmt: skip
        contradicted = due & ~recovered

    verdict = jnp.asarray(Verdict.FUSED)

    def unless(good: Bool[Array, ""], otherwise: Verdict) -> None:
        nonlocal verdict
        verdict = jnp.where(good, verdict, otherwise)

    # In rising order of importance: the last reason that applies is the verdict.
    unless(jnp.asarray(score.accepted), Verdict.DROPPED)
    unless(score.nis <= score.threshold, Verdict.GATED)
    # 1e300 m are as little a reading as infinitely many; a gate calls them an outlier.
    sensible = jnp.isfinite(score.nis) | jnp.isfinite(score.threshold)
    unless(is_sound(posterior) & ~jnp.isnan(score.nis) & sensible, Verdict.NOT_FINITE)
    if reading.cov is not None:
        unless(
            is_positive_definite(model.noise_cov(belief.moments().mean)), Verdict.BAD_COVARIANCE
        )
    infinite = [jnp.isinf(leaf).any() for leaf in jax.tree.leaves(reading.measurement)]
    unless(model.possible(belief.moments().mean, measurement), Verdict.NOT_FINITE)
    unless(model.present.any() & ~jnp.stack(infinite).any(), Verdict.NOT_FINITE)
    unless(jnp.asarray(state.behind) == 0, Verdict.UNPREDICTED)
    unless(installation.knows(reading.target), Verdict.UNKNOWN_TARGET)
    unless(reading.target != REPEATED, Verdict.DUPLICATE)

    fused = verdict == Verdict.FUSED
    judged = fused | (verdict == Verdict.GATED) | (verdict == Verdict.DROPPED)
    # A filter that refuses says itself what it keeps: a gate may count its refusals.
    kept = jax.tree.map(lambda new, old: jnp.where(judged, new, old), posterior, belief)
    outlying = judged & outlying & ~recovered
    if clocks is not None:
        good = fused & ~outlying
        clocks = clocks.after(place, reading.target, time, good, outlying, contradicted)

    if times is not None and state.fused is not None:
        times = jnp.where(looked_at & fused, time, times)
        state = state._replace(fused=(*state.fused[:place], times, *state.fused[place + 1 :]))

    size = space_of(installation.sensor.measures).size
    shown = model.present & judged
    pad = jnp.full(widest(sensors) - size, jnp.nan)

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
        effective_size=known(score.effective_size),
        resampled=fused & score.resampled,
        repairs=jnp.where(judged, score.repairs, 0),
        outlying=outlying,
        recovered=fused & recovered,
    )
    return state._replace(belief=kept, clocks=clocks, readings=number), outcome


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
        effective_size=nothing,
        resampled=jnp.asarray(False),
        repairs=jnp.asarray(0),
        outlying=jnp.asarray(False),
        recovered=jnp.asarray(False),
    )


def widest(sensors: Sequence[Installation]) -> int:
    """Size of the largest measurement, to which outcomes are padded."""
    return max((space_of(s.sensor.measures).size for s in sensors), default=0)


def prediction_key(key: PRNGKeyArray, number: Int[Array, ""] | int) -> PRNGKeyArray:
    """The key of a prediction, counted from 1.

    Events at which nothing happens (a time asked for twice, a control) do not count, so they
    change no draw. ``key`` itself is never used to draw, and no key is used twice.
    """
    return fold_in(fold_in(key, 1), number)


def reading_key(key: PRNGKeyArray, number: Int[Array, ""] | int) -> PRNGKeyArray:
    """The key of a reading, counted from 1; see :func:`prediction_key`."""
    return fold_in(fold_in(key, 2), number)
