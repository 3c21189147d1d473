"""An IMU's samples as a control, and which of them are questioned."""

from pathlib import Path

import numpy as np
import pytest

from kedge.core.errors import DataError
from kedge.formats.inertial import held, question, unit_of
from kedge.formats.tables import Table

STEP = 5_000_000  # ns


def table(stamps):
    return Table("imu", Path("imu.csv"), stamps, {}, {}, np.arange(2, len(stamps) + 2), {})


def standing(count=200):
    force = np.tile([0.0, 0.0, 9.81], (count, 1))
    return np.arange(count) * STEP, force, np.full((count, 3), 0.01)


def test_a_sample_is_held_or_joined_to_the_next():
    """Of a signal 2 t + t^2 (its integral t^2 + t^3 / 3), known at 0, 1, 3 s."""
    stamps, time = np.array([0, 1, 3]) * 1_000_000_000, np.array([0.0, 1.0, 3.0])
    values = 2 * time + time**2
    kept = held(stamps, {"turn_x": values}, "previous")
    np.testing.assert_allclose(kept["turn_x"], values)
    np.testing.assert_allclose(kept["turn_slope_x"], 0.0)
    joined = held(stamps, {"turn_x": values}, "trapezoid")
    np.testing.assert_allclose(joined["turn_x"][:2], [1.5, 9.0])
    np.testing.assert_allclose(joined["turn_slope_x"][:2], [3.0, 6.0])


def test_increments_are_integrals_over_the_step_that_ends():
    time = np.array([0.0, 1.0, 3.0])
    integral = time**2 + time**3 / 3
    told = np.append(0.0, np.diff(integral))
    driven = held((time * 1e9).astype(np.int64), {"turn_x": told}, "increments")
    np.testing.assert_allclose(driven["turn_x"][:2] * np.diff(time), np.diff(integral))
    assert unit_of("rad/s", "increments") == "rad"
    assert unit_of("m/s^2", "increments") == "m/s"
    assert unit_of("rad/s", "trapezoid") == "rad/s"


def test_an_imu_that_stands_is_not_questioned():
    stamps, force, rate = standing()
    assert question(table(stamps), force, rate) == []


def test_a_first_step_out_of_proportion_is_refused():
    stamps, force, rate = standing()
    stamps = stamps + np.where(np.arange(200) > 0, 700 * STEP, 0)
    with pytest.raises(DataError, match=r"imu.csv:3: imu: the first step takes 3.505 s"):
        question(table(stamps), force, rate)


def test_rates_in_degrees_are_refused_or_questioned():
    stamps, force, rate = standing()
    with pytest.raises(DataError, match=r"angular rate of 155.9 rad/s.*is it in deg/s"):
        question(table(stamps), force, np.full_like(rate, 90.0))
    (note,) = question(table(stamps), force, np.full_like(rate, 5.0))
    assert (
        "faster than once a second in 100 % of the log; is the angular rate in deg/s?" in note
    )


@pytest.mark.parametrize(
    ("scale", "hint"),
    [(1 / 9.81, "multiples of g"), (0.001, "taken out"), (5.0, "is its unit right")],
)
def test_a_specific_force_that_cannot_be_is_refused(scale, hint):
    stamps, force, rate = standing()
    with pytest.raises(DataError, match=hint):
        question(table(stamps), force * scale, rate)
    (note,) = question(table(stamps), force * 1.3, rate)
    assert "is 12.8 m/s^2 in the median, not 9.8" in note
