"""A filter's pass over a log, compiled once, and how well it foresaw each reading."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from kedge.checking.setting import Setting
from kedge.core.contracts import AbstractFilter
from kedge.estimation.log import Log
from kedge.estimation.rig import as_arrays
from kedge.estimation.runner import Runner
from kedge.estimation.traced import Estimates
from kedge.evaluation.consistency import chi_square_bound

SURE = 0.999
"""Probability up to which a residual counts by its square; an outlier beyond by its length."""
BLOCKS = 20
"""Stretches of the log whose gains are compared: what is correlated lies within one."""
JUDGED = 0.98
"""Share of the readings that a hypothesis must judge as well, or it is none."""


class Evaluated(NamedTuple):
    """A pass over a log, and its score by reading: sensors one after the other, by row."""

    estimates: Estimates
    log: Log
    score: Float[np.ndarray, " r"]
    """NaN where a reading was not judged."""
    time: Float[np.ndarray, " r"]


class Gain(NamedTuple):
    """By how much a hypothesis foresaw the readings better than another."""

    total: float
    """Logarithm of the ratio of likelihoods."""
    steady: float
    """Its mean over stretches of the log, in standard errors of that mean."""


class Program:
    """The pass of a filter over what changes make of one rig and log."""

    def __init__(self, filter: AbstractFilter, setting: Setting):
        self.filter = as_arrays(filter)
        sizes = [len(r.target) for r in setting.line.readings]
        self.begins: Int[np.ndarray, " s"] = np.concatenate([[0], np.cumsum(sizes)])
        given = self._given(setting, setting.log())
        self.runner = Runner(given)
        self.runner.compile(given)

    def _given(self, setting: Setting, log: Log) -> Any:
        return as_arrays((self.filter, setting.rig, log))

    def evaluate(self, setting: Setting, log: Log | None = None) -> Evaluated:
        """Run over a setting's log, or over another form of it."""
        log = setting.log() if log is None else log
        estimates, _ = self.runner.over(self._given(setting, log))
        estimates = jax.tree.map(np.asarray, estimates)
        score = np.full(self.begins[-1], np.nan)
        time = np.full(self.begins[-1], np.nan)
        sensor, row = np.asarray(log.schedule.sensor), np.asarray(log.schedule.row)
        read = sensor >= 0
        at = self.begins[sensor[read]] + row[read]
        score[at] = (log_scores(estimates) + np.append(setting.density, 0.0)[sensor])[read]
        time[at] = np.asarray(log.schedule.time)[read]
        return Evaluated(estimates, log, score, time)


def log_scores(estimates: Estimates) -> Float[np.ndarray, " T"]:
    r"""How well each reading was foreseen: $-\rho(\nu^T S^{-1} \nu)/2 - \sum_i \log s_i$.

    Of readings that a gate refused too, so that refusing is no way to score: beyond the bound
    of ``SURE`` the square grows as its root does (Huber), and one outlier decides nothing. The
    $s_i$ are the standard deviations of the residual's components.

    Source: P. Huber, E. Ronchetti, "Robust Statistics", 2nd ed., 2009, section 4.5.
    """
    outcome = estimates.outcome
    nis, dof, bound = _bounded(estimates)
    with np.errstate(all="ignore"):
        far = np.where(nis > bound, bound * (2 * np.sqrt(nis / bound) - 1), nis)
        width = np.nansum(np.log(np.asarray(outcome.std)), axis=1)
    return np.where(dof > 0, -far / 2 - width, np.nan)


def squares(evaluated: Evaluated, sensors: int) -> Float[np.ndarray, "s m"]:
    """By sensor and component, the mean square of whitened residuals; outliers count less.

    It is by how much the score falls as residuals grow with the logarithm of their size; 1 of
    what was never judged.
    """
    white, bound = np.asarray(evaluated.estimates.outcome.white), chi_square_bound(1, SURE)
    sensor = np.asarray(evaluated.log.schedule.sensor)
    _, dof, _ = _bounded(evaluated.estimates)
    share = np.ones((sensors, white.shape[1]))
    for place in range(sensors):
        square = white[(sensor == place) & (dof > 0)] ** 2
        square = square[np.isfinite(square).all(axis=1)]
        if len(square):
            share[place] = np.minimum(square, np.sqrt(square * bound)).mean(axis=0)
    return share


def _bounded(estimates: Estimates) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """NIS, degrees of freedom, and the bound beyond which a residual is an outlier."""
    nis, dof = np.asarray(estimates.outcome.nis), np.asarray(estimates.outcome.dof)
    bounds = {int(d): chi_square_bound(int(d), SURE) for d in np.unique(dof) if d > 0}
    return nis, dof, np.array([bounds.get(int(d), np.inf) for d in dof])


def gain(new: Evaluated, old: Evaluated) -> Gain:
    """By how much ``new`` foresaw the readings better than ``old``."""
    more = new.score - old.score
    known = np.isfinite(more)
    if not known.any() or known.sum() < JUDGED * np.isfinite(old.score).sum():
        return Gain(-np.inf, 0.0)
    time, more = old.time[known], more[known]
    edges = np.linspace(time.min(), time.max() + 1e-9, BLOCKS + 1)
    sums, _ = np.histogram(time, edges, weights=more)
    spread = float(sums.std(ddof=1)) * np.sqrt(BLOCKS)
    total = float(more.sum())
    return Gain(total, float(total / spread) if spread > 0 else 0.0)
