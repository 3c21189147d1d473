"""Ranges that come one by one, put together to epochs."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from kedge.core.errors import DataError


class Epochs(NamedTuple):
    """Tables of ranges, one row an epoch."""

    time: Float[np.ndarray, " n"]
    """Mean time of the ranges of each, s."""
    ranges: Float[np.ndarray, "n m"]
    """NaN where an anchor was not heard; m."""
    rows: Int[np.ndarray, "n m"]
    """The row that each came from, -1 where there is none."""


def epochs_of(
    time: Float[np.ndarray, " k"],
    target: Int[np.ndarray, " k"],
    ranges: Float[np.ndarray, " k"],
    anchors: int,
    window: float = 0.05,
) -> Epochs:
    """Split at the first range that comes later than ``window`` s after its epoch's first.

    A second range of the same anchor begins an epoch too. Targets below 0 are left out.

    Raises:
        DataError: no range is of a known anchor, or a window is not above or at 0.
    """
    if not window >= 0:
        raise DataError(f"epochs: window is {window:g} s, expected 0 or more")
    kept = np.flatnonzero((target >= 0) & (target < anchors))
    if len(kept) == 0:
        raise DataError("epochs: found no range of an anchor that is on the map")
    number, first, seen = -1, -np.inf, set[int]()
    of = np.empty(len(kept), int)
    for place, (at, which) in enumerate(
        zip(time[kept].tolist(), target[kept].tolist(), strict=True)
    ):
        if number < 0 or at - first > window + 1e-9 or which in seen:
            number, first, seen = number + 1, at, set()
        seen.add(which)
        of[place] = number
    table = np.full((number + 1, anchors), np.nan)
    rows = np.full((number + 1, anchors), -1)
    table[of, target[kept]] = ranges[kept]
    rows[of, target[kept]] = kept
    total = np.bincount(of, time[kept]) / np.bincount(of)
    return Epochs(total, table, rows)
