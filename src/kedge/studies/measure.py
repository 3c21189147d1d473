"""What filters are given of simulated runs, and what they made of it, scored."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from kedge.core.manifolds import Space, space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Log
from kedge.evaluation.consistency import chi_square_bound
from kedge.numerics.linalg import UNROLLED, UNROLLED_COLUMNS, cholesky, solve_lower
from kedge.simulation.scenario import History, Scenario
from kedge.simulation.simulate import Simulation, with_readings
from kedge.studies.filter_pass import Believed, Given
from kedge.studies.scores import RunScores, TimeSums


class Plan(NamedTuple):
    """What all runs share: their events, and at which of them they are scored."""

    log: Log
    events: Int[np.ndarray, " K"]
    """Those scored."""
    steps: Int[np.ndarray, " K"]
    """The step at whose end each scored event lies."""
    settled: Bool[np.ndarray, " K"]
    """Whether the burn-in is over."""
    time: Float[np.ndarray, " K"]  # s
    sensed: Int[np.ndarray, " E"]
    """The events with a reading."""
    sensor: Int[np.ndarray, " E"]
    sensed_settled: Bool[np.ndarray, " E"]
    sensed_time: Float[np.ndarray, " E"]  # s
    steps_settled: Bool[np.ndarray, " S"]
    """Of all steps."""
    windows: Mapping[str, "Window"] = {}


class Window(NamedTuple):
    """Some of the times of a run that are scored apart."""

    events: Bool[np.ndarray, " K"]
    """Of those scored."""
    sensed: Bool[np.ndarray, " E"]
    steps: Bool[np.ndarray, " S"]


@eqx.filter_jit
def given_of(scenario: Scenario, plan: Plan, truth: Simulation, means: Any) -> Given:
    """The runs as filters are told of them; leading run axis."""

    def one(true: Simulation) -> tuple[Any, Any]:
        log = with_readings(plan.log, scenario, true)
        return log.controls, log.readings

    return Given(means, *jax.vmap(one)(truth))


@eqx.filter_jit
def scored(
    scenario: Scenario,
    plan: Plan,
    truth: Simulation,
    beliefs: Believed,
    kept: Bool[Array, " runs"],
) -> tuple[RunScores, RunScores, dict[str, RunScores], TimeSums, Any]:
    """Scores of some runs (late, whole, by window), sums of those kept, means of the first.

    It knows of no filter, so it is compiled once for all of a study's.
    """
    states = space_of(type(scenario.rig.prior.mean))
    sensors = len(scenario.rig.sensors)

    def one(true: Simulation, belief: Believed):
        actual = jax.tree.map(lambda leaf: leaf[plan.steps], true.truth)
        error = jax.vmap(states.boxminus)(actual, belief.mean)
        nees = jnp.full(len(plan.events), jnp.nan)
        within = jnp.full(error.shape, jnp.nan)
        if belief.cov is not None:
            nees = jax.vmap(squared_distance)(belief.cov, error)
            variance = jnp.diagonal(belief.cov, axis1=1, axis2=2)
            within = jnp.where(error**2 <= 9 * variance, 1.0, 0.0)
        nis = jnp.full(len(plan.sensed), jnp.nan) if belief.nis is None else belief.nis
        fused = belief.verdict == Verdict.FUSED
        watched = _tracked(scenario, true)
        judged = _Judged(error**2, nees, within, nis, 1.0 * belief.dof, fused, watched)
        settled = plan.settled, plan.sensed_settled, plan.steps_settled
        late = _scores(states, plan, judged, sensors, *settled)
        whole = _scores(states, plan, judged, sensors, *map(jnp.ones_like, settled))
        apart = {
            name: _scores(states, plan, judged, sensors, *window)
            for name, window in plan.windows.items()
        }
        return late, whole, apart, judged

    late, whole, apart, judged = jax.vmap(one)(truth, beliefs)
    good = kept & jnp.all(jnp.isfinite(whole.squared), axis=1)
    good &= jnp.isfinite(late.time_mean_rms)

    def added(leaf: Array, counted: Array) -> Array:
        shape = (len(good),) + (1,) * (leaf.ndim - 1)
        return jnp.sum(jnp.where(good.reshape(shape) & counted, leaf, 0.0), axis=0)

    fused = judged.fused
    sums = TimeSums(
        total=jnp.sum(jnp.where(good, 1.0, 0.0)),
        squared=added(judged.squared, jnp.ones_like(judged.squared, bool)),
        nees=added(judged.nees, jnp.ones_like(judged.nees, bool)),
        nis=added(judged.nis, fused),
        nis_count=added(jnp.ones_like(judged.nis), fused),
        nis_dof=added(judged.dof, fused),
    )
    return late, whole, apart, sums, jax.tree.map(lambda leaf: leaf[0], beliefs.mean)


def squared_distance(cov: Float[Array, "n n"], error: Float[Array, " n"]) -> Float[Array, ""]:
    r"""$e^\top P^{-1} e$; NaN where P is not positive definite.

    The last row of the factor of $[P, e; e^\top, c]$ is the whitened error, whatever c is, as
    long as it is larger: one call of the library instead of two, which takes half as long.
    """
    if (size := len(error)) <= UNROLLED:
        return jnp.sum(solve_lower(cholesky(cov), error) ** 2)
    corner = jnp.full((1, 1), jnp.finfo(cov.dtype).max / 4, cov.dtype)
    bordered = jnp.block([[cov, error[:, None]], [error[None], corner]])
    return jnp.sum(cholesky(bordered)[size, :size] ** 2)


class _Judged(NamedTuple):
    """One run by time and by reading."""

    squared: Float[Array, "*K n"]
    nees: Float[Array, "*K"]
    within: Float[Array, "*K n"]
    nis: Float[Array, "*E"]
    dof: Float[Array, "*E"]
    fused: Bool[Array, "*E"]
    tracked: Float[Array, "*S w"]


def _tracked(scenario: Scenario, true: Simulation) -> Float[Array, "S w"]:
    """Squares of what the world watches; nothing without a world."""
    if scenario.world is None:
        return jnp.zeros((scenario.steps, 0))
    history = History(true.truth, true.controls, true.start)
    return scenario.world.watch(scenario, history) ** 2


def _scores(
    states: Space,
    plan: Plan,
    judged: _Judged,
    sensors: int,
    when: Bool[Array | np.ndarray, " K"],
    sensed: Bool[Array | np.ndarray, " E"],
    stepped: Bool[Array | np.ndarray, " S"],
) -> RunScores:
    """Means over some of the times of one run."""
    share = jnp.where(when, 1.0, 0.0) / jnp.sum(jnp.where(when, 1.0, 0.0))

    def mean(values: Float[Array, " K"]) -> Float[Array, ""]:
        # What is not finite must not leak in from times that are not looked at.
        return jnp.sum(jnp.where(when, values, 0.0) * share)

    nis, dof = [], []
    for number in range(sensors):
        fused = sensed & judged.fused & (plan.sensor == number)
        count = jnp.sum(fused)
        for values, means in ((judged.nis, nis), (judged.dof, dof)):
            total = jnp.sum(jnp.where(fused, values, 0.0))
            means.append(jnp.where(count > 0, total / jnp.maximum(count, 1), jnp.nan))
    bound = chi_square_bound(states.size, 0.95)
    known = states.size <= UNROLLED_COLUMNS
    inside = jnp.where(judged.nees <= bound, 1.0, 0.0)
    return RunScores(
        time_mean_rms=mean(jnp.sqrt(jnp.mean(judged.squared, axis=1))),
        squared=jax.vmap(mean, 1)(judged.squared),
        nees=mean(judged.nees),
        coverage=mean(inside) if known else jnp.asarray(jnp.nan),
        within=jax.vmap(mean, 1)(judged.within),
        nis=jnp.stack(nis) if nis else jnp.zeros(0),
        nis_dof=jnp.stack(dof) if dof else jnp.zeros(0),
        tracked=jnp.mean(judged.tracked, axis=0, where=stepped[:, None]),
        singular=mean(1.0 * jnp.isnan(judged.nees)) if known else jnp.asarray(jnp.nan),
    )
