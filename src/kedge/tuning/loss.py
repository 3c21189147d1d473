"""What tuning makes small: how badly a filter foretold its readings, or knew its own error."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.special import gammaln

from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import Chart, charts_of, space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates, estimate
from kedge.estimation.log import Log, Recording, Truth
from kedge.estimation.rig import Rig
from kedge.evaluation.truth import truth_at
from kedge.filters.wrappers.withholding import Withholding
from kedge.numerics.linalg import cholesky, solve_lower
from kedge.numerics.losses import TUNING, Loss

SOFT = TUNING["student"]


class Tails(NamedTuple):
    """How each sensor's innovations are judged, by the sensor's index."""

    freedom: Float[np.ndarray, " s"]
    """Degrees of freedom of a Student-t; infinite for the normal distribution."""
    weight: Float[np.ndarray, "s d"]
    """What the Student-t's term is multiplied by, by the number of components minus one."""


class Known(NamedTuple):
    """What is known of the truth at the output times."""

    events: Int[np.ndarray, " K"]
    fields: dict[str, np.ndarray]
    there: Bool[np.ndarray, " K"]


def ungated(rig: Rig) -> tuple[Rig, Tails, list[str]]:
    """The rig without gates, how its innovations are judged, and what to say of that.

    A gate makes the likelihood jump where a reading enters or leaves, so tuning weighs
    readings down instead: by the sensor's own robust loss, else by a Student-t's.
    """
    size = max((space_of(s.sensor.measures).size for s in rig.sensors), default=1)
    sensors, freedom, weight, notes = [], [], [], []
    for installation in rig.sensors:
        nu, factor = np.inf, np.ones(size)
        if installation.robust is not None or installation.gate is not None:
            loss = installation.robust or Loss("student", SOFT)
            student = loss.kind == "student"
            nu = float(SOFT if not student or loss.tuning is None else loss.tuning)
            if installation.robust is None or not student:
                factor = np.array([consistent_weight(nu, d) for d in range(1, size + 1)])
            installation = dataclasses.replace(
                installation, gate=None, robust=loss, recovery=np.inf
            )
            notes.append(
                f"{installation.name}: judged by a Student-t with {nu:g} degrees of freedom, "
                "without a gate, which would make the likelihood jump"
            )
        sensors.append(installation)
        freedom.append(nu)
        weight.append(factor)
    tails = Tails(np.array(freedom), np.array(weight).reshape(len(sensors), size))
    return Rig(rig.vehicle, tuple(sensors), rig.prior), tails, notes


def consistent_weight(freedom: float, dof: int) -> float:
    r"""The weight with which a Student-t's loss finds the right scale of normal noise.

    $\kappa$ with $\kappa\,E[(\nu + d)\,q / (\nu + q)] = d$ for $q \sim \chi^2_d$: without it a
    fit to normal noise comes out too narrow, by a fifth for $\nu = 4$.

    Source: R. Maronna, R. Martin, V. Yohai, M. Salibián-Barrera, "Robust Statistics: Theory
    and Methods", 2019, section 2.5 (M-estimates of scale).
    """
    # Substituting q = exp(t) leaves an integrand that is smooth and vanishes at both ends.
    grid = np.linspace(-40.0, 8.0, 20001)
    squared = np.exp(grid)
    half = dof / 2
    density = np.exp(half * grid - squared / 2 - half * np.log(2) - gammaln(half))
    pull = (freedom + dof) * squared / (freedom + squared)
    return float(dof / (np.sum(pull * density) * (grid[1] - grid[0])))


def known_truth(recording: Recording, truth: Truth, state: Any) -> Known:
    """The truth at the output times, for the fields of a state."""
    time = np.asarray(recording.log.schedule.time)[recording.outputs]
    fields, known = truth_at(truth, time, charts_of(type(state)))
    return Known(recording.outputs, fields, known)


def innovation_losses(
    estimates: Estimates, sensor: Int[Array, " T"], tails: Tails
) -> tuple[Float[Array, " T"], Bool[Array, " T"]]:
    r"""Minus the log-likelihood of every reading that was fused, 0 elsewhere; and which were.

    Normal: $\tfrac12(\nu^\top S^{-1} \nu + \log\det S + d \log 2\pi)$. With heavy tails
    $\tfrac12(\log\det S + \kappa (n + d) \log(1 + \nu^\top S^{-1} \nu / n) + c)$, with n
    degrees of freedom and a constant c that keeps the two comparable where n is large.

    Source: F. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE
    Transactions on Information Theory 11(1), 1965 (the normal one).
    """
    outcome = estimates.outcome
    fused = outcome.verdict == Verdict.FUSED
    at = jnp.maximum(sensor, 0)
    nis, dof = jnp.where(fused, outcome.nis, 0.0), jnp.maximum(outcome.dof, 1)
    constant = dof * jnp.log(2 * jnp.pi)
    log_det = -2 * outcome.log_likelihood - nis - constant
    freedom = jnp.asarray(tails.freedom)[at]
    heavy = jnp.isfinite(freedom)
    nu = jnp.where(heavy, freedom, 1.0)
    student = jnp.asarray(tails.weight)[at, dof - 1] * (nu + dof) * jnp.log1p(nis / nu)
    loss = 0.5 * (log_det + constant + jnp.where(heavy, student, nis))
    return jnp.where(fused, loss, 0.0), fused


def truth_losses(
    estimates: Estimates, known: Known
) -> tuple[Float[Array, " K"], Bool[Array, " K"]]:
    r"""Minus the log-density of the true error under the belief, at every output time.

    $\tfrac12(e^\top P^{-1} e + \log\det P + d \log 2\pi)$ with $e = x \boxminus \hat x$ and P
    the block of the covariance of the fields that truth knows: a small error and an honest
    covariance make it small. 0 where truth is unknown; the second result says where it is
    known.
    """
    mean = jax.tree.map(lambda leaf: leaf[known.events], estimates.moments.mean)
    states = space_of(type(mean))
    cuts: dict[str, slice] = states.slices()
    charts: dict[str, Chart] = dict(zip(states.cls._fields, states.charts, strict=True))
    names = list(known.fields)
    picked = np.concatenate([np.arange(cuts[n].start, cuts[n].stop) for n in names])
    cov = estimates.moments.cov[known.events][:, picked][:, :, picked]

    def one(true: dict[str, Array], believed: Any, cov: Float[Array, "k k"]):
        parts = [charts[n].boxminus(true[n], getattr(believed, n)) for n in names]
        root = cholesky(cov)
        white = solve_lower(root, jnp.concatenate(parts))
        log_det = 2 * jnp.sum(jnp.log(jnp.diag(root)))
        return 0.5 * (white @ white + log_det + len(picked) * jnp.log(2 * jnp.pi))

    loss = jax.vmap(one)(jax.tree.map(jnp.asarray, known.fields), mean, cov)
    covered = jnp.asarray(known.there)
    return jnp.where(covered, loss, 0.0), covered


class Losses(eqx.Module):
    """The losses of a rig on a log, by event (of readings) or by output time (of truth)."""

    filter: AbstractFilter
    tails: Tails
    known: Known | None
    """Given, the truth is what is judged; else the readings."""
    horizons: Float[np.ndarray, " h"]
    """s; given, a reading is judged as predicted over each, held back with all others."""

    def __call__(
        self, rig: Rig, log: Log
    ) -> tuple[Float[Array, " N"], Int[Array, " N"], Int[Array, ""]]:
        """The losses, how many judgements each stands for, and how many readings were fused.

        Each reading is held back once for each horizon, and its losses are added up: a
        composite likelihood, of marginal densities.

        Source: C. Varin, N. Reid, D. Firth, "An overview of composite likelihood methods",
        Statistica Sinica 21(1), 2011.
        """
        time, sensor, _ = log.schedule
        if not len(self.horizons):
            estimates = estimate(self.filter, rig, log)
            losses, judged = innovation_losses(estimates, sensor, self.tails)
            count = jnp.sum(judged)
            if self.known is not None:
                losses, judged = truth_losses(estimates, self.known)
            return losses, judged.astype(int), count

        def over(horizon: Array, phase: Array) -> tuple[Array, Array, Array]:
            filter = Withholding(self.filter, horizon=horizon, phase=phase)
            losses, fused = innovation_losses(estimate(filter, rig, log), sensor, self.tails)
            held = fused & filter.holds_back(time)
            return jnp.where(held, losses, 0.0), held, jnp.sum(fused)

        # The passes share the schedule, so that each sensor stays a branch.
        phases = jnp.tile(jnp.arange(2.0), len(self.horizons))
        passes = jnp.repeat(jnp.asarray(self.horizons), 2), phases
        losses, judged, count = jax.vmap(over)(*passes)
        return losses.sum(axis=0), judged.sum(axis=0), count.sum()
