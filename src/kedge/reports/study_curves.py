"""Curves over time, coarse enough to be told apart on a page."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.evaluation.consistency import chi_square_interval
from kedge.studies.scores import TimeSums
from kedge.studies.study import Plan

BINS = 200
"""Of a curve; with more, neighbours melt into a band."""


class NisCurve(NamedTuple):
    """One sensor's NIS by component over time, and the bounds that it should keep."""

    time: Float[np.ndarray, " b"]
    nis: Float[np.ndarray, " b"]
    low: Float[np.ndarray, " b"]
    high: Float[np.ndarray, " b"]
    end: float
    """Of the run, in s."""


def coarse(
    time: Float[np.ndarray, " K"], values: Float[np.ndarray, " K"]
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"]]:
    """Means over stretches of time, at their ends, if there are too many points."""
    starts = _starts(len(time))
    sizes = np.diff(np.append(starts, len(time)))
    return time[starts + sizes - 1], np.add.reduceat(values, starts) / sizes


def nis_curve(plan: Plan, sums: TimeSums, sensor: int) -> NisCurve:
    r"""Mean NIS over runs and neighbouring readings, divided by the degrees of freedom.

    Innovations of a right filter are independent in time, so that a sum of them is chi-square
    with the sum of their degrees of freedom, and so are the bounds found.

    Source: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to
    Tracking and Navigation", 2001, section 5.4.2.
    """
    dof, total = np.asarray(sums.nis_dof), np.asarray(sums.nis)
    chosen = np.flatnonzero((plan.sensor == sensor) & (dof > 0) & np.isfinite(total))
    end = float(plan.time[-1])
    if not len(chosen):
        none = np.zeros(0)
        return NisCurve(none, none, none, none, end)
    starts = _starts(len(chosen))
    ends = np.append(starts[1:], len(chosen)) - 1
    freedom = np.add.reduceat(dof[chosen], starts)
    bounds = {f: np.array(chi_square_interval(f)) / f for f in np.unique(freedom).tolist()}
    low, high = np.stack([bounds[f] for f in freedom.tolist()], axis=1)
    return NisCurve(
        plan.sensed_time[chosen[ends]],
        np.add.reduceat(total[chosen], starts) / freedom,
        low,
        high,
        end,
    )


def _starts(count: int) -> np.ndarray:
    bins = min(BINS, count)
    return np.arange(bins) * count // max(bins, 1)
