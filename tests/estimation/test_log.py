"""Merging sources into one log, against the slow and obvious way."""

from typing import NamedTuple

import jax
import numpy as np
import pytest

from kedge.core.errors import DataError
from kedge.estimation.log import SECOND, Readings, Stamped, alike, assemble


class Control(NamedTuple):
    speed: np.ndarray


class Fix(NamedTuple):
    position: np.ndarray


START = 1_700_000_000 * SECOND


def source(stamps):
    stamps = np.asarray(stamps, np.int64)
    return Stamped(
        START + stamps, Readings(Fix(np.arange(len(stamps)) * 1.0), np.zeros(len(stamps), int))
    )


def merged(stamps=(0, 30, 70, 70, 120), sources=((10, 30, 200), (30, 90)), end=120, rate=1.0):
    stamps = np.asarray(stamps, np.int64)
    controls = Control(10.0 + np.arange(len(stamps)))
    return assemble(
        START, START + end, START + stamps, controls, [source(s) for s in sources], rate
    )


def test_events_stand_in_the_order_of_time_control_and_sensor():
    schedule = merged().log.schedule
    assert [round(t * SECOND) for t in schedule.time.tolist()] == [
        *(10, 30, 30, 30, 70, 70, 90, 120)
    ]
    assert schedule.sensor.tolist() == [0, -1, 0, 1, -1, -1, 1, -1]
    assert schedule.row.tolist() == [0, 0, 1, 0, 0, 0, 1, 0]
    assert merged().stamps.tolist() == [START + t for t in (10, 30, 30, 30, 70, 70, 90, 120)]


def test_a_control_holds_from_its_stamp_on():
    random = np.random.default_rng(0)
    for _ in range(20):
        stamps = np.sort(random.integers(0, 100, 6))
        recording = merged(stamps, (np.sort(random.integers(0, 100, 5)),), end=100)
        last = START
        for stamp, control in zip(
            recording.stamps, recording.log.controls.speed.tolist(), strict=True
        ):
            # What the vehicle was told when the interval began; at first, what comes first.
            known = [i for i, s in enumerate(stamps) if START + s <= last]
            assert control == 10.0 + (known[-1] if known else 0)
            last = stamp


def test_what_lies_outside_is_left_out():
    recording = merged(sources=((-10, 0, 120, 121),), stamps=(-5, 500))
    assert recording.stamps.tolist() == [START, START + 120]
    assert recording.log.schedule.row.tolist() == [1, 2]
    assert recording.log.controls.speed.tolist() == [10, 10]


@pytest.mark.parametrize(
    ("seconds", "rate", "count"),
    [(0.29, 100.0, 29), (0.7, 10.0, 7), (3.0, 0.1, 0), (10.0, 0.3, 3), (206.0, 10.0, 2060)],
)
def test_outputs_are_asked_for_up_to_the_end(seconds, rate, count):
    end = round(seconds * SECOND)
    recording = assemble(
        START, START + end, np.array([START + 1]), Control(np.ones(1)), [], rate
    )
    stamps = recording.stamps[recording.outputs] - START
    expected = np.round(np.arange(1, count + 1) * (SECOND / rate)).astype(np.int64)
    np.testing.assert_array_equal(stamps, expected)
    assert (recording.log.schedule.sensor == -1).all()


def test_a_stamp_minus_its_latency_is_the_time_of_the_event():
    """Latency is taken off before logs are merged, so that a slow sensor's reading is fused
    where it belongs, between readings that were stamped before it."""
    prompt, delay = np.array([10, 40, 70]), 25
    seen, told = merged(sources=(prompt, (55,))), merged(sources=(prompt, (55 + delay,)))
    shifted = merged(sources=(prompt, np.array([55 + delay]) - delay))
    for one, other in zip(seen.log.schedule, shifted.log.schedule, strict=True):
        np.testing.assert_array_equal(one, other)
    order = [s for s in seen.log.schedule.sensor.tolist() if s >= 0]
    assert order == [0, 0, 1, 0]
    assert [s for s in told.log.schedule.sensor.tolist() if s >= 0] == [0, 0, 0, 1]


def test_a_vehicle_without_controls():
    recording = assemble(START, START + 100, np.zeros(0, np.int64), (), [source([40])], 1.0)
    assert recording.log.controls == ()
    assert recording.stamps.tolist() == [START + 40]


@pytest.mark.parametrize("end", [0, -5])
def test_a_log_that_ends_before_it_starts_is_refused(end):
    with pytest.raises(DataError, match=f"empty log: it ends at {START + end} ns"):
        merged(end=end)


def test_a_log_in_which_nothing_happens_is_refused():
    with pytest.raises(DataError, match="no control, reading or output time lies inside it"):
        merged(stamps=(-5,), sources=((-10, 500),))


def test_logs_made_alike_end_with_nothing():
    """Shapes are one; events and readings are those of before, then nothing happens."""
    short, long = merged(), merged(sources=((10, 30, 50, 60), (30,)))
    both = alike([short, long])
    shapes = [[np.shape(leaf) for leaf in jax.tree.leaves(one.log)] for one in both]
    assert shapes[0] == shapes[1]
    for before, after in zip((short, long), both, strict=True):
        count = len(before.stamps)
        for old, new in zip(before.log.schedule, after.log.schedule, strict=True):
            np.testing.assert_array_equal(new[:count], old)
        assert (
            np.asarray(after.log.schedule.time[count:]) == before.log.schedule.time[-1]
        ).all()
        assert (np.asarray(after.log.schedule.sensor[count:]) == -1).all()
        for old, new in zip(before.log.readings, after.log.readings, strict=True):
            kept = new.measurement.position[: len(old.target)]
            np.testing.assert_array_equal(kept, old.measurement.position)
        np.testing.assert_array_equal(after.outputs, before.outputs)


def test_logs_that_cannot_be_made_alike():
    with pytest.raises(DataError, match="expected one rig's logs"):
        alike([merged(), merged(sources=((10,),))])
    with pytest.raises(DataError, match="expected none to be empty"):
        alike([merged(), merged(sources=((10,), ()))])
