"""How each sensor's readings come: rate, gaps, jitter; where they stand still or do not fit."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from kedge.checking.program import Evaluated
from kedge.checking.setting import Setting
from kedge.estimation.log import REPEATED
from kedge.evaluation.consistency import chi_square_bound

FEWEST = 8
"""Readings of the same value from which on a sensor may be stuck."""
SHORTEST = 1.0  # s that it lasts at least
UNFIT = 3.0
"""Times what NIS is elsewhere, from which on a model does not hold."""
WINDOW = 10, 2.0
"""Readings, and s, that are judged together at the least."""
Span = tuple[float, float]


class Stream(NamedTuple):
    """When the readings of a sensor, or of one of its targets, came."""

    readings: int
    rate: float
    """Hz, from the usual step."""
    jitter: float
    """s; how the steps scatter, by their median deviation."""
    longest_gap: float
    """s."""
    gaps: int
    """Steps of more than three times the usual one."""


def stream(time: Float[np.ndarray, " n"]) -> Stream | None:
    """The stream of readings at these times (s); None of fewer than three."""
    step = np.diff(np.unique(time))
    if len(step) < 2:
        return None
    usual = float(np.median(step))
    jitter = 1.4826 * float(np.median(np.abs(step - usual)))
    return Stream(
        len(time), 1 / usual, jitter, float(step.max()), int((step > 3 * usual).sum())
    )


class Judged(NamedTuple):
    """The readings of one sensor, in order of time, as a pass judged them."""

    time: Float[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    target: Int[np.ndarray, " n"]
    nis: Float[np.ndarray, " n"]
    dof: Int[np.ndarray, " n"]
    white: Float[np.ndarray, "n m"]


def judged(setting: Setting, evaluated: Evaluated, place: int) -> Judged:
    """Those of the sensor at ``place`` that were judged."""
    schedule, outcome = evaluated.log.schedule, evaluated.estimates.outcome
    dof = np.asarray(outcome.dof)
    events = np.flatnonzero((np.asarray(schedule.sensor) == place) & (dof > 0))
    row = np.asarray(schedule.row)[events]
    target = np.asarray(setting.line.readings[place].target)[row]
    time, nis = np.asarray(schedule.time)[events], np.asarray(outcome.nis)[events]
    return Judged(time, row, target, nis, dof[events], np.asarray(outcome.white)[events])


def stuck(setting: Setting, evaluated: Evaluated, place: int) -> list[tuple[Span, np.ndarray]]:
    """From when to when a sensor read the same value though it should not, and the rows.

    At a stop a reading may stay as it is: it must also be foreseen badly.
    """
    readings = judged(setting, evaluated, place)
    leaves = jax.tree.leaves(setting.line.readings[place].measurement)
    values = np.hstack([np.reshape(leaf, (len(leaf), -1)) for leaf in leaves])
    spans = []
    for target in np.unique(readings.target):
        of_target = np.flatnonzero(readings.target == target)
        same = (np.diff(values[readings.row[of_target]], axis=0) == 0).all(axis=1)
        for begin, end in _runs(same):
            run = of_target[begin : end + 1]
            first, last = float(readings.time[run[0]]), float(readings.time[run[-1]])
            bad = readings.nis[run].mean() > 2 * readings.dof[run].mean()
            if len(run) >= FEWEST and last - first >= SHORTEST and bad:
                spans.append(((first, last), readings.row[run]))
    return spans


def without(setting: Setting, place: int, rows: Int[np.ndarray, " k"]) -> Setting:
    """The setting without some of the readings of a sensor."""
    every = setting.line.readings
    target = np.asarray(every[place].target).copy()
    target[rows] = REPEATED
    readings = (*every[:place], every[place]._replace(target=target), *every[place + 1 :])
    return setting._replace(line=setting.line._replace(readings=readings))


def unfit(readings: Judged) -> list[Span]:
    """From when to when readings are foreseen far worse than in most of the log."""
    least, seconds = WINDOW
    total = len(readings.time)
    lasted = float(readings.time[-1] - readings.time[0]) if total > 1 else 0.0
    size = max(least, math.ceil(seconds * total / lasted) if lasted > 0 else least)
    count = total // size
    if count < 5:
        return []
    rows = np.arange(count * size).reshape(count, size)
    share = readings.nis[rows].sum(axis=1) / readings.dof[rows].sum(axis=1)
    dof = int(readings.dof[rows].sum(axis=1).max())
    usual = max(float(np.median(share)), 1.0)
    bound = usual * max(UNFIT, chi_square_bound(dof, 1 - 1e-7) / dof)
    return [
        (float(readings.time[rows[begin, 0]]), float(readings.time[rows[end - 1, -1]]))
        for begin, end in _runs(share > bound)
    ]


def _runs(flags: Bool[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    """Where stretches of True begin and where they end (behind the last)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
