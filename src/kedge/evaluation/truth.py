"""What is known of the true trajectory at a time, and at which times to ask."""

from collections.abc import Mapping

import jax
import numpy as np
from jaxtyping import Bool, Float, Int64

from kedge.core.manifolds import Chart
from kedge.estimation.log import SECOND, Truth

MAX_GAP = 0.5  # s; across a longer gap truth is unknown, unless it never comes more often

SPARSE = 0.9
"""s between samples, from which on nobody knows the way between them (1 Hz, jittered)."""


def longest_gap(time: Float[np.ndarray, " K"]) -> float:
    """The longest gap between samples of truth, in s, across which it is still known."""
    return max(MAX_GAP, 1.5 * float(np.median(np.diff(time)))) if len(time) > 1 else MAX_GAP


def judged_at(
    truth: Truth, start: int, end: int, rate: float
) -> Int64[np.ndarray, " j"] | None:
    """The stamps in ns of a truth that is sparse, and sparser than outputs at ``rate`` Hz.

    None if it is dense, or lies outside ``start`` (excluded) to ``end``.
    """
    if len(truth.time) < 2 or np.median(np.diff(truth.time)) < max(SPARSE, 1 / rate):
        return None
    stamps = start + np.round(truth.time * SECOND).astype(np.int64)
    inside = stamps[(stamps > start) & (stamps <= end)]
    return inside if len(inside) else None


def truth_at(
    truth: Truth,
    time: Float[np.ndarray, " K"],
    charts: Mapping[str, Chart],
    max_gap: float | int | None = None,
) -> tuple[dict[str, np.ndarray], Bool[np.ndarray, " K"]]:
    """The true fields with a chart, on the shortest way between samples; and where known.

    Outside the samples, and across gaps longer than ``max_gap`` (:func:`longest_gap` if it is
    not given), truth is not known; the values there mean nothing.
    """
    max_gap = longest_gap(truth.time) if max_gap is None else max_gap
    right = np.searchsorted(truth.time, time).clip(1, len(truth.time) - 1)
    span = truth.time[right] - truth.time[right - 1]
    share = (time - truth.time[right - 1]) / span
    covered = (share >= 0) & (share <= 1) & ((span <= max_gap) | (share == 0) | (share == 1))
    fields = {}
    for name, chart in charts.items():
        if name in truth.fields:
            values = truth.fields[name]
            fields[name] = _between(chart, values[right - 1], values[right], share)
    return fields, covered


def _between(
    chart: Chart, before: np.ndarray, after: np.ndarray, share: Float[np.ndarray, " K"]
) -> np.ndarray:
    """Points on the chart's shortest ways from ``before`` to ``after``."""

    @jax.jit
    @jax.vmap
    def one(before, after, part):
        return chart.boxplus(before, part * chart.boxminus(after, before))

    return np.asarray(one(before, after, share))
