"""What headers in the wild seem to be."""

import numpy as np
import pytest

from kedge.formats.guesses import compassed, guess, time_unit, weighed


@pytest.mark.parametrize(
    ("header", "largest", "expected"),
    [
        ("w_RS_S_z [rad s^-1]", 60.0, ("angular_rate_z", "rad/s")),
        ("a_RS_S_x [m s^-2]", 1.0, ("specific_force_x", "m/s^2")),
        ("gyro_y", 120.0, ("angular_rate_y", "deg/s")),
        ("p_RS_R_x [m]", 5.0, ("position_x", "m")),
        ("field.latitude", 48.2, ("latitude", "deg")),
        ("Lon", 0.6, ("longitude", "rad")),
        ("heading_degrees", 1.0, ("heading", "deg")),
        ("yaw", 359.0, ("heading", "deg")),
        ("theta", 3.1, ("heading", "rad")),
        ("velocity (km/h)", 12.0, ("speed", "km/h")),
        ("twist.twist.linear.x".replace(".", "_"), 1.0, ("speed", "m/s")),
        ("DVL X [m/s]", 2.0, ("velocity_body_x", "m/s")),
        ("Easting", 5e5, ("position_x", "m")),
        ("dist_mm", 5000.0, ("range", "mm")),
        ("orientation_w", 1.0, ("attitude_w", "1")),
        ("covariance_x", 1.0, None),
        ("temperature", 20.0, None),
        ("max", 20.0, None),
    ],
)
def test_names_and_sizes_say_what_a_column_is(header, largest, expected):
    found = guess(header, np.array([0.0, -largest, np.nan]))
    assert (found and (found.name, found.unit)) == expected


def test_gravity_tells_forces_in_g():
    numbers = {
        f"acc_{axis}": np.full(5, value)
        for axis, value in zip("xyz", (0.0, 0.1, 1.0), strict=True)
    }
    columns = {column: guess(column, values) for column, values in numbers.items()}
    assert {g.unit for g in weighed(columns, numbers).values()} == {"g"}
    heavy = {column: 9.8 * values for column, values in numbers.items()}
    assert {g.unit for g in weighed(columns, heavy).values()} == {"m/s^2"}


@pytest.mark.parametrize(
    ("header", "time", "unit"),
    [
        ("time", 12.5, "s"),
        ("time", 1.7e9, "s"),
        ("stamp", 1.7e12, "ms"),
        ("stamp", 1.7e15, "us"),
        ("#timestamp [ns]", 5.0, "ns"),
        ("t", 1.7e18, "ns"),
    ],
)
def test_times_are_of_today(header, time, unit):
    assert time_unit(header, np.array([time, time])) == unit


@pytest.mark.parametrize(
    ("third", "axes"),
    [("V Down [m/s]", {"North": "x", "East": "y"}), ("vel_up", {"North": "y"})],
)
def test_the_points_of_the_compass_are_axes_of_one_frame(third, axes):
    """North is x where down is z, and y where up is z."""
    headers = ["V North [m/s]", "V East [m/s]", third]
    columns, ned = compassed({h: guess(h, np.zeros(3)) for h in headers})
    assert ned is ("Down" in third)
    assert columns[third].name == "velocity_z"
    for point, axis in axes.items():
        assert columns[f"V {point} [m/s]"].name == f"velocity_{axis}"
