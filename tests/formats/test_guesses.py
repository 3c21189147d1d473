"""What headers in the wild seem to be."""

import numpy as np
import pytest

from kedge.formats.guesses import (
    compassed,
    counts_from_north,
    guess,
    in_one_unit,
    ticks,
    time_unit,
    weighed,
)


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
        ("Easting", 5e5, ("position_east", "m")),
        ("wheel_speed_kmh", 30.0, ("speed", "km/h")),
        ("gyro_z_dps", 3.0, ("angular_rate_z", "deg/s")),
        ("Geschwindigkeit [km/h]", 3.0, ("speed", "km/h")),
        ("Drehrate [°/s]", 3.0, ("yaw_rate", "deg/s")),
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


def test_easting_and_northing_are_x_and_y():
    columns, _ = compassed({h: guess(h, np.zeros(3)) for h in ("Easting", "Northing", "east")})
    assert {c: g.name for c, g in columns.items()} == {
        "Easting": "position_x",
        "Northing": "position_y",
    }


def test_roll_is_in_degrees_where_the_heading_is():
    largest = {"roll": 3.0, "pitch_rad": 0.1, "yaw": 359.0}
    columns = {name: guess(name, np.array([size])) for name, size in largest.items()}
    units = {name: guessed.unit for name, guessed in in_one_unit(columns).items()}
    assert units == {"roll": "deg", "pitch_rad": "rad", "yaw": "deg"}


@pytest.mark.parametrize(("scale", "unit"), [(100.0, "1"), (0.7, "m/s")])
def test_large_whole_numbers_of_wheels_are_ticks(scale, unit):
    numbers = {name: scale * np.arange(5.0) for name in ("left", "right")}
    columns = {name: guess(name, values) for name, values in numbers.items()}
    assert {g.unit for g in ticks(columns, numbers).values()} == {unit}


@pytest.mark.parametrize("names", [("x", "y"), ("lon", "lat")])
@pytest.mark.parametrize("compass", [True, False])
def test_the_way_tells_from_where_a_heading_counts(names, compass):
    heading = np.radians(np.linspace(10, 170, 50))
    x, y = np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))
    if names[0] == "lon":  # at 60 degrees north, a degree of longitude is half as long
        x, y = 9 + 2e-5 * x, 60 + 1e-5 * y
    told = (90 - np.degrees(heading)) % 360 if compass else np.degrees(heading)
    numbers = dict(zip((*names, "yaw"), (x, y, told), strict=True))
    columns = {name: guess(name, values) for name, values in numbers.items()}
    assert counts_from_north(columns, numbers) is compass
