"""What filters are given of simulated runs, and what they made of it, scored."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import Space, space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Log
from kedge.estimation.runner import Given
from kedge.estimation.traced import Estimates
from kedge.evaluation.consistency import chi_square_bound
from kedge.numerics.linalg import UNROLLED, UNROLLED_COLUMNS, cholesky, solve_lower
from kedge.simulation.scenario import History, Scenario
from kedge.simulation.simulate import Simulation, with_readings
from kedge.studies.scores import RunScores, TimeSums
from kedge.studies.study import Plan


def given_of(
    filter: AbstractFilter, scenario: Scenario, plan: Plan, truth: Simulation, means: Any
) -> Given:
    """The runs as a filter is told of them; its prior's mean, controls and readings by run."""
    log = plan.log
    return _with((filter, scenario.rig, log), means, *_logged(scenario, log, truth))


def per_run(given: Given) -> Any:
    """Flags for a tree like it: what has a leading axis of runs."""
    _, rig, log = jax.tree.map(lambda _: True, given)
    common = jax.tree.map(lambda _: False, given)
    return _with(common, rig.prior.mean, log.controls, log.readings)


def _with(given: Given, mean: Any, controls: Any, readings: Any) -> Given:
    filter, rig, log = given
    rig = eqx.tree_at(lambda r: r.prior, rig, Gaussian(mean, rig.prior.cov))
    return filter, rig, Log(log.schedule, controls, readings)


@eqx.filter_jit
def _logged(scenario: Scenario, log: Log, truth: Simulation) -> tuple[Any, Any]:
    return jax.vmap(lambda true: with_readings(log, scenario, true)[1:])(truth)


class Believed(NamedTuple):
    """What scores need of a run's estimates."""

    mean: Any
    """At the scored events."""
    cov: Float[Array, "*K n n"] | None
    """Of states that are small enough for a NEES."""
    verdict: Int[Array, "*E"]
    dof: Int[Array, "*E"]
    nis: Float[Array, "*E"] | None
    """Of measurements that are small enough."""
    outlying: Bool[Array, "*E"]


class Pick(eqx.Module):
    """Picks of estimates what scores need."""

    scored: Int[Array | np.ndarray, " K"]
    sensed: Int[Array | np.ndarray, " E"]
    cov: bool = eqx.field(static=True)
    nis: bool = eqx.field(static=True)

    def __call__(self, estimates: Estimates) -> Believed:
        moments, outcome = estimates.moments, estimates.outcome
        return Believed(
            mean=jax.tree.map(lambda leaf: leaf[self.scored], moments.mean),
            cov=moments.cov[self.scored] if self.cov else None,
            verdict=outcome.verdict[self.sensed],
            dof=outcome.dof[self.sensed],
            nis=outcome.nis[self.sensed] if self.nis else None,
            outlying=outcome.outlying[self.sensed],
        )


def pick_of(given: Given, plan: Plan) -> Pick:
    """With covariances and NIS where XLA forms those of scores without a loop."""
    _, rig, _ = given
    widest = max((s.sensor.dof() for s in rig.sensors), default=0)
    size = space_of(type(rig.prior.mean)).size
    return Pick(plan.events, plan.sensed, size <= UNROLLED_COLUMNS, widest <= UNROLLED)


@eqx.filter_jit
def scored(
    scenario: Scenario,
    plan: Plan,
    truth: Simulation,
    beliefs: Believed,
    kept: Bool[Array | np.ndarray, " runs"],
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
        weighed = fused | (belief.verdict == Verdict.GATED)
        watched = _tracked(scenario, true)
        judged = _Judged(
            error**2,
            nees,
            within,
            nis,
            1.0 * belief.dof,
            fused,
            watched,
            weighed,
            belief.outlying,
        )
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
    weighed: Bool[Array, "*E"]
    """Fused, or refused by a gate."""
    outlying: Bool[Array, "*E"]


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

    nis, dof, outlying = [], [], []
    for number in range(sensors):
        mine = sensed & (plan.sensor == number)
        weighed = jnp.sum(mine & judged.weighed)
        outlying.append(jnp.sum(mine & judged.outlying) / weighed)
        fused = mine & judged.fused
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
        outlying=jnp.stack(outlying) if outlying else jnp.zeros(0),
    )
