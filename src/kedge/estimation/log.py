"""Logs: what happened, in time order.

The schedule (when, which sensor) is separate from the readings (what was measured). All runs
of a Monte Carlo study share one schedule, so ``vmap`` over runs keeps each ``lax.switch`` a
real branch instead of evaluating every sensor at every event.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from kedge.core.errors import DataError

SECOND = 1_000_000_000  # ns
REPEATED = -2
"""In place of a target: the same reading stands in the log already."""


class Schedule(NamedTuple):
    """When something happens, and to whom."""

    time: Float[Array, " T"]
    """Time of the event in s since the log's start."""
    sensor: Int[Array, " T"]
    """Index of the sensor that fired, or -1 for a prediction without a measurement."""
    row: Int[Array, " T"]
    """Row of that sensor's readings."""


class Readings(NamedTuple):
    """All readings of one sensor in time order; or one, without the leading axis."""

    measurement: Any
    """NaN where a component is missing."""
    target: Int[Array, "*n"]
    """Index on the sensor's map, 0 without a map; -1 for a target that is not on it, -2
    (``REPEATED``) for a reading that stands in the log already."""
    cov: Float[Array, "*n m m"] | None = None
    """Covariances that came with the readings, in place of the sensor's own."""


class Log(NamedTuple):
    """A run's events."""

    schedule: Schedule
    controls: Any
    """Control held over the interval that ends at each event; leading axis T."""
    readings: tuple[Readings, ...]
    """Per sensor."""


class Truth(NamedTuple):
    """What is known of the true trajectory: fields of the state by name."""

    time: Float[np.ndarray, " K"]
    """s since the log's start."""
    fields: dict[str, np.ndarray]
    own_frame: bool = False
    """Its frame is not that of the map, and has to be found from the trajectories."""


class Stamped(NamedTuple):
    """One sensor's readings with their event times, before they are merged."""

    stamps: Int[np.ndarray, " n"]
    """Event times in ns."""
    readings: Readings


class Recording(NamedTuple):
    """A log, and what is needed to speak about it outside traced code."""

    log: Log
    start: int
    """ns since the epoch of the sources; ``log.schedule.time`` counts from here."""
    stamps: Int[np.ndarray, " T"]
    """Exact event times in ns."""
    outputs: Int[np.ndarray, " K"]
    """Indices of the events at which the estimate is asked for."""
    truth: Truth | None = None
    """The true trajectory, where the log has one."""
    judged: Int[np.ndarray, " J"] | None = None
    """Indices of the events at which it is compared with truth; None: at the outputs."""
    notes: tuple[str, ...] = ()
    """What was left out or changed when it was read."""


def assemble(
    start: int,
    end: int,
    control_stamps: Int[np.ndarray, " c"],
    controls: Any,
    sources: Sequence[Stamped],
    output_rate: float,
    judged: Int[np.ndarray, " j"] | None = None,
) -> Recording:
    """Merge controls, readings, output times and those of a sparse truth into one log.

    Events from ``start`` to ``end``, both included. Controls are held from their stamp on; the
    first also before it. Events at one time stand
    in the order control, sensors as installed, output, ``judged``.

    Raises:
        DataError: nothing happens between ``start`` and ``end``, or floats cannot tell its
            times apart.
    """
    if end <= start:
        raise DataError(f"empty log: it ends at {end} ns and starts at {start} ns")
    count = int((end - start) * output_rate / SECOND)
    grid = start + np.round(np.arange(1, count + 1) * (SECOND / output_rate)).astype(np.int64)
    inside = (control_stamps > start) & (control_stamps <= end)
    tables = [(control_stamps[inside], -1)]
    tables += [(source.stamps, index) for index, source in enumerate(sources)]
    tables += [(grid, -2), (np.zeros(0, np.int64) if judged is None else judged, -3)]

    stamps = np.concatenate([stamps for stamps, _ in tables])
    sensor = np.concatenate([np.full(len(s), index) for s, index in tables])
    rank = np.concatenate([np.full(len(s), place) for place, (s, _) in enumerate(tables)])
    row = np.concatenate([np.arange(len(s)) for s, _ in tables])
    order = np.lexsort((row, rank, stamps))
    order = order[(stamps[order] >= start) & (stamps[order] <= end)]
    if len(order) == 0:
        raise DataError("empty log: no control, reading or output time lies inside it")
    stamps, sensor, row = stamps[order], sensor[order], row[order]

    _check_resolution(stamps - start)
    before = np.concatenate([[start], stamps[:-1]])
    held = np.searchsorted(control_stamps, before, side="right") - 1
    at_events = jax.tree.map(lambda leaf: jnp.asarray(leaf[np.maximum(held, 0)]), controls)
    schedule = Schedule(
        jnp.asarray((stamps - start) / SECOND),
        jnp.asarray(np.maximum(sensor, -1)),
        jnp.asarray(np.where(sensor >= 0, row, 0)),
    )
    readings = tuple(jax.tree.map(jnp.asarray, without_repeats(source)) for source in sources)
    return Recording(
        Log(schedule, at_events, readings),
        start,
        stamps,
        np.flatnonzero(sensor == -2),
        judged=None if judged is None else np.flatnonzero(sensor == -3),
    )


def _check_resolution(since_start: Int[np.ndarray, " T"]) -> None:
    """Refuse times that the floats in use would round to other steps.

    Raises:
        DataError: the last time is rounded by more than a hundredth of the usual step.
    """
    steps = np.diff(since_start)
    if not (steps > 0).any():
        return
    step, last = float(np.median(steps[steps > 0])) / SECOND, since_start[-1] / SECOND
    rounding = float(np.spacing(np.asarray(last, jnp.zeros(()).dtype)))
    if rounding > 0.01 * step:
        raise DataError(
            f"the log lasts {last:g} s, where 32-bit floats resolve {rounding:.2g} s, but its "
            f"steps are {step:.2g} s: use 64 bits (JAX_ENABLE_X64=1) or a shorter part (until)"
        )


def events_of(log: Log | Recording) -> Log:
    """The events, of a recording too."""
    return log.log if isinstance(log, Recording) else log


def without_repeats(source: Stamped) -> Readings:
    """Mark readings that repeat an earlier one: same time, target, values and covariance."""
    count = len(source.stamps)
    if len(np.unique(source.stamps)) == count:
        return source.readings
    columns = [np.asarray(leaf) for leaf in jax.tree.leaves((source.stamps, source.readings))]
    flat = [np.ascontiguousarray(column.reshape(count, -1)) for column in columns]
    rows = np.hstack([column.view(np.uint8).reshape(count, -1) for column in flat])
    _, first = np.unique(rows, axis=0, return_index=True)
    repeated = np.ones(count, bool)
    repeated[first] = False
    target = np.where(repeated, REPEATED, np.asarray(source.readings.target))
    return source.readings._replace(target=target)


def alike(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings of one rig, with as many events and readings each: one program fits all.

    The shorter ones end with events at which nothing happens, and with readings that no event
    takes up.

    Raises:
        DataError: they are not of one rig, or a sensor read nothing in one and something in
            another.
    """
    shapes = [[len(r.target) for r in one.log.readings] for one in recordings]
    if len({len(shape) for shape in shapes}) > 1:
        raise DataError(f"alike: found {shapes} readings by sensor, expected one rig's logs")
    most = np.max(shapes, axis=0)
    if any(not have and need for one in shapes for have, need in zip(one, most, strict=True)):
        raise DataError(f"alike: found {shapes} readings by sensor, expected none to be empty")
    events = max(len(one.stamps) for one in recordings)

    def longer(leaf: Any, size: int) -> Array:
        leaf = jnp.asarray(leaf)
        return jnp.concatenate([leaf, jnp.repeat(leaf[-1:], size - len(leaf), axis=0)])

    recordings_of_one_shape = []
    for one in recordings:
        time, sensor, row = one.log.schedule
        idle = jnp.full(events - len(sensor), -1, jnp.asarray(sensor).dtype)
        schedule = Schedule(
            longer(time, events),
            jnp.concatenate([jnp.asarray(sensor), idle]),
            longer(row, events),
        )
        controls = jax.tree.map(lambda leaf: longer(leaf, events), one.log.controls)
        readings = tuple(
            jax.tree.map(lambda leaf, n=int(n): longer(leaf, n), part)
            for part, n in zip(one.log.readings, most, strict=True)
        )
        recordings_of_one_shape.append(one._replace(log=Log(schedule, controls, readings)))
    return recordings_of_one_shape
