"""The most probable trajectory: smoothing that linearises again where it led."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import space_of
from kedge.estimation.batch import Estimates, estimate_with_history
from kedge.estimation.log import Log, Recording, events_of
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.smoother import backward, rauch_tung_striebel
from kedge.estimation.traced import whole_pass
from kedge.estimation.transition import innermost
from kedge.filters.gaussian.along import LinearisedAlong
from kedge.filters.gaussian.recursion import AbstractMomentPrediction
from kedge.numerics.propagation import AbstractPropagation, SigmaPoints, Taylor
from kedge.numerics.quadrature import cubature

STEPS, HALVINGS = 30, 8
TOLERANCE = 1e-4
"""Standard deviations by which nothing moves any more."""


class MostProbable(NamedTuple):
    """The result of :func:`most_probable`."""

    filtered: Estimates
    """What the filter believed, by which readings were judged."""
    estimates: Estimates
    """The most probable states, and their covariances by the curvature there."""
    costs: tuple[float, ...]
    """Of the smoothed trajectory, and after each step."""
    seconds: float
    """Of the passes, without compiling."""


class _Step(NamedTuple):
    """A trajectory's cost, and where the smoother linearised along it leads."""

    cost: Float[Array, ""]
    moments: Gaussian
    """After each event."""
    points: Gaussian
    """Before the first prediction and after each one."""


def most_probable(
    filter: AbstractFilter,
    rig: Rig,
    log: Log | Recording,
    key: PRNGKeyArray | None = None,
    progress: Callable[[str], None] | None = None,
) -> MostProbable:
    r"""Maximise the posterior density of the whole trajectory, from the smoothed one on.

    Steps of Gauss and Newton: the log is passed and smoothed with models that are linearised
    along the trajectory so far (:class:`~kedge.filters.gaussian.along.LinearisedAlong`). A step
    is halved until the cost does not rise. Robust losses weigh by the smoothed residual under
    R; a gate counts as a Student-t. A filter with sigma points linearises over the smoothed
    covariances instead, and its steps are whole: it has no cost that it minimises. This is
    weak-constraint 4D-Var by another name.

    Raises:
        ContractError: the filter carries neither a Gaussian nor an ensemble.

    Source: B. Bell, "The iterated Kalman smoother as a Gauss-Newton method", SIAM J.
    Optimization 4(3), 1994; S. Särkkä, "Bayesian Filtering and Smoothing", 2013, chapter 10;
    Y. Trémolet, "Accounting for an imperfect model in 4D-Var", Q. J. R. Meteorol. Soc. 132,
    2006.
    """
    key = jr.key(0) if key is None else key
    filtered, history = estimate_with_history(filter, rig, log, key)
    filter, rig, events = as_arrays((filter, rig, events_of(log)))
    smoothed = rauch_tung_striebel(filtered.moments, history)
    strategy = _strategy(filter)
    states = space_of(type(rig.prior.mean))
    at = _points(rig.prior, smoothed, history, events)
    compiled = _step.lower(at, strategy, rig, events, key).compile()
    begin = time.perf_counter()

    def step(at: Gaussian) -> _Step:
        return compiled(at, strategy, rig, events, key)

    best = step(at)
    costs = [float(best.cost)]
    for number in range(STEPS):
        way = jax.vmap(states.boxminus)(best.points.mean, at.mean)
        deviation = jnp.sqrt(jnp.diagonal(best.points.cov, axis1=1, axis2=2))
        far = float(jnp.max(jnp.abs(way) / jnp.maximum(deviation, 1e-12)))
        if progress is not None:
            progress(f"step {number}: cost {costs[-1]:.6g}, to move {far:.2g} sigma at most")
        if far < TOLERANCE:
            break
        for halving in range(HALVINGS + 1):
            mean = jax.vmap(states.boxplus)(at.mean, 0.5**halving * way)
            trial = Gaussian(mean, best.points.cov)
            after = step(trial)
            if not strategy.affine or after.cost <= best.cost * (1 + 1e-12):
                break
        else:
            break
        at, best = trial, after
        costs.append(float(best.cost))
    estimates = filtered._replace(moments=best.moments)
    return MostProbable(filtered, estimates, tuple(costs), time.perf_counter() - begin)


def _strategy(filter: AbstractFilter) -> AbstractPropagation:
    inner = innermost(filter)
    if not isinstance(inner, AbstractMomentPrediction) or inner.strategy().affine:
        return Taylor()
    # Weights below 0 have no root.
    return SigmaPoints(cubature) if inner.strategy().signed else inner.strategy()


def _stepped(
    at: Gaussian, strategy: AbstractPropagation, rig: Rig, log: Log, key: PRNGKeyArray
) -> _Step:
    along = LinearisedAlong(at.mean, at.cov, strategy)
    estimates, history, last = whole_pass(along, rig, log, key, True)
    moments = rauch_tung_striebel(estimates.moments, history)
    return _Step(last.belief.cost, moments, _points(rig.prior, moments, history, log))


_step: Any = eqx.filter_jit(_stepped)


def _points(prior: Gaussian, smoothed: Gaussian, history: Any, log: Log) -> Gaussian:
    """The smoothed states by number of predictions; the last one fills up what is not used."""
    first, record = jax.tree.map(lambda leaf: leaf[0], (smoothed, history))
    start = backward(prior, first, record)
    number = _predictions(log)
    place = jnp.searchsorted(number, jnp.arange(1, len(number) + 1), side="right") - 1

    def joined(one: Array, leaf: Array) -> Array:
        return jnp.concatenate([jnp.asarray(one)[None], leaf[place]])

    return jax.tree.map(joined, start, smoothed)


def _predictions(log: Log) -> Int[Array, " T"]:
    """How many predictions there were up to each event: one where time has passed."""
    times = jnp.asarray(log.schedule.time)
    newest = jnp.concatenate([jnp.zeros(1), jax.lax.cummax(times)[:-1]])
    return jnp.cumsum(times > jnp.maximum(newest, 0.0))
