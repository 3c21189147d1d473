"""The part of a log that is tuned on, rearranged when a latency moves its readings in time."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from kedge.core.errors import DataError
from kedge.estimation.log import Log, Readings, Recording, Schedule


class Timeline(NamedTuple):
    """Events as the rig's own latencies place them, on the host."""

    time: Float[np.ndarray, " T"]
    sensor: Int[np.ndarray, " T"]
    row: Int[np.ndarray, " T"]
    rank: Int[np.ndarray, " T"]
    """What comes first of events at one time: controls, sensors as installed, outputs."""
    is_control: Bool[np.ndarray, " T"]
    is_output: Bool[np.ndarray, " T"]
    controls: Any
    """Those told: the first at the start, then what holds from each event on."""
    readings: tuple[Readings, ...]


class Arranged(NamedTuple):
    """A log in the order of time for one choice of latencies."""

    log: Log
    outputs: Int[np.ndarray, " K"]


def timeline(
    recording: Recording, until: float | int, earlier: Float[np.ndarray, " s"]
) -> Timeline:
    """The events up to ``until`` seconds.

    Readings that a latency may move before the start, by up to ``earlier`` seconds by sensor,
    are left out: the readings that are judged must be the same ones throughout.

    Raises:
        DataError: no event is left.
    """
    log = jax.tree.map(np.asarray, recording.log)
    time, sensor = log.schedule.time, log.schedule.sensor
    is_output = np.zeros(len(time), bool)
    is_output[recording.outputs] = True
    earliest = np.append(earlier, 0.0)[sensor]
    kept = np.flatnonzero((time <= until) & (time >= earliest))
    if len(kept) == 0:
        raise DataError(f"nothing of the log is left to tune on in its first {until:g} s")

    def at_controls(leaf: np.ndarray) -> np.ndarray:
        # What holds from an event on is what holds up to the next.
        return np.concatenate([leaf[:1], leaf[np.minimum(kept + 1, len(leaf) - 1)]])

    is_control = (sensor < 0) & ~is_output
    rank = np.where(is_output, len(earlier), sensor)
    return Timeline(
        time[kept],
        sensor[kept],
        log.schedule.row[kept],
        rank[kept],
        is_control[kept],
        is_output[kept],
        jax.tree.map(at_controls, log.controls),
        log.readings,
    )


def arranged(line: Timeline, later: Float[np.ndarray, " s"]) -> Arranged:
    """The log in order once the latency of each sensor has grown by ``later`` seconds.

    The schedule keeps the times as recorded; only its order is that of the times moved.
    """
    shifted = line.time - np.append(later, 0.0)[line.sensor]
    order = np.lexsort((line.row, line.rank, shifted))
    # The control that holds up to an event is the last one told before it.
    latest = np.maximum.accumulate(np.where(line.is_control[order], order + 1, 0))
    last = np.concatenate([[0], latest[:-1]])
    controls = jax.tree.map(lambda leaf: jnp.asarray(leaf[last]), line.controls)
    columns = (jnp.asarray(column[order]) for column in (line.time, line.sensor, line.row))
    log = Log(Schedule(*columns), controls, line.readings)
    return Arranged(log, np.flatnonzero(line.is_output[order]))
