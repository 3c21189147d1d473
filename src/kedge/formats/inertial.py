"""Readings of an inertial measurement unit as the control of a vehicle.

A control is held from its stamp on. Here samples are brought to that form, and questioned when
they cannot be what they are said to be.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from jaxtyping import Float, Int64

from kedge.core.errors import DataError
from kedge.estimation.log import SECOND
from kedge.formats.tables import Table

Sampling = Literal["previous", "trapezoid", "means", "increments", "counts", "poses"]
"""How the step after a sample is driven: by itself, by the mean of it and the next, or
by the next, which tells the mean or the integral over the step; or by what a counter of
ticks, or the pose of an odometry, changes by until the next."""
SLOPE = "_slope"
FASTEST = 35.0  # rad/s; 2000 degrees a second, the widest range of small gyroscopes
BRISK = 2 * np.pi  # rad/s
STRETCH = 10.0


def unit_of(unit: str, sampling: Sampling) -> str:
    """The unit of a column: that of its integral if increments are told."""
    integrals = {"rad/s": "rad", "m/s^2": "m/s", "m/s": "m", "1/s": "1"}
    return integrals.get(unit, unit) if sampling in ("increments", "counts") else unit


def held(
    stamps: Int64[np.ndarray, " n"],
    columns: Mapping[str, Float[np.ndarray, " n"]],
    sampling: Sampling,
) -> dict[str, Float[np.ndarray, " n"]]:
    """What drives the step from each stamp to the next; from the last on, what came before.

    With its slope: ``NAME_x`` gives ``NAME_slope_x`` too.
    """
    steps = np.diff(stamps) / SECOND
    found: dict[str, Float[np.ndarray, " n"]] = {}
    for name, values in columns.items():
        samples = values
        if sampling == "increments":
            samples = values / np.append(steps[:1], steps)
        change = np.diff(samples) / steps
        driven = samples
        if sampling == "trapezoid":
            driven = np.append((samples[1:] + samples[:-1]) / 2, samples[-1])
        elif sampling in ("means", "increments"):
            driven = np.append(samples[1:], samples[-1])
        stem, _, axis = name.rpartition("_")
        found[name] = driven
        # A sample that is held does not change within its step.
        slope = np.zeros(len(steps)) if sampling == "previous" else change
        found[f"{stem}{SLOPE}_{axis}"] = np.append(slope, 0.0)
    return found


def question(
    table: Table, force: Float[np.ndarray, "n 3"], rate: Float[np.ndarray, "n 3"]
) -> list[str]:
    """What to say of an IMU whose readings are odd.

    Raises:
        DataError: its first step is out of all proportion, or its readings cannot be rad/s and
            m/s^2.
    """
    steps = np.diff(table.stamps) / SECOND
    if len(steps) > 2:
        usual = float(np.median(steps))
        if steps[0] > STRETCH * usual:
            raise DataError(
                f"{table.path}:{table.lines[1]}: {table.name}: the first step takes "
                f"{steps[0]:.6g} s, the others {usual:.6g} s; expected a step like the others: "
                "correct the first stamp or leave its row out"
            )
    speeds, pulls = np.linalg.norm(rate, axis=1), np.linalg.norm(force, axis=1)
    at = int(np.argmax(speeds))
    if speeds[at] > FASTEST:
        raise DataError(
            f"{table.path}:{table.lines[at]}: {table.name}: found an angular rate of "
            f"{speeds[at]:.4g} rad/s, expected at most {FASTEST:g}; is it in deg/s? Then say "
            'so where its columns are declared (unit = "deg/s")'
        )
    pull = float(np.median(pulls))
    if not 4.0 < pull < 25.0:
        hint = (
            'it looks like multiples of g (unit = "g")'
            if 0.7 < pull < 1.4
            else "gravity seems to have been taken out, and an IMU feels it"
            if pull < 0.7
            else "is its unit right?"
        )
        raise DataError(
            f"{table.path}: {table.name}: the specific force is {pull:.4g} m/s^2 in the "
            f"median, expected about 9.8; {hint}"
        )
    notes = []
    brisk = float(np.mean(speeds > BRISK))
    if brisk > 0.01:
        notes.append(
            f"{table.name}: turns faster than once a second in {100 * brisk:.0f} % of the log; "
            "is the angular rate in deg/s?"
        )
    if abs(pull - 9.8) > 1.0:
        notes.append(
            f"{table.name}: the specific force is {pull:.3g} m/s^2 in the median, not 9.8; is "
            "its unit right?"
        )
    return notes
