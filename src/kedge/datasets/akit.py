"""Runs of a sea-going AUV with a Doppler log, and the post-processed navigation beside it.

A run is two files, ``DVL_trajectoryN.csv`` (velocities forward, right, down) and
``GT_trajectoryN.csv`` (geodetic position, velocity north, east, down, and roll, pitch, yaw).
The map has its origin where the reference begins, and its height 0 at that of the file.

Source: N. Cohen and I. Klein, "Adaptive Kalman-Informed Transformer", Engineering Applications
of Artificial Intelligence 146, 2025 (the recordings of the Snapir).
"""

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import readers, unknown
from kedge.estimation.log import SECOND
from kedge.formats.cells import read_cells
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table, build_table, check_order, require_finite
from kedge.numerics.earth import Origin

TIME = "Time [s]"
DOPPLER = {f"DVL {axis} [m/s]": (f"velocity_body_{axis.lower()}", "m/s") for axis in "XYZ"}
REFERENCE = {
    "Longitude [rad]": ("longitude", "rad"),
    "Latitude [rad]": ("latitude", "rad"),
    "Altitude [m]": ("height", "m"),
    "V North [m/s]": ("north", "m/s"),
    "V East [m/s]": ("east", "m/s"),
    "V Down [m/s]": ("down", "m/s"),
    "Roll [rad]": ("roll", "rad"),
    "Pitch [rad]": ("pitch", "rad"),
    "Yaw [rad]": ("yaw", "rad"),
}
"""Column of a file -> what it is called here, unit."""
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.diag([1.0, -1.0, -1.0])
AXES = "xyz"
RATE = 10  # Hz


@readers.add("auv_akit_snapir")
def read_akit(path: Path, part: str | None = None) -> RawLog:
    """Read one run of a folder.

    Its sources are ``dvl``, ``reference`` and ``rates``. The reference is the truth as well:
    position, attitude and velocity in the body. No gyroscope was recorded: the angular rates
    are those of a spline through the reference's attitudes, before and after. A note says how
    far the reference's own velocity and position are apart.

    Args:
        path: a folder with DVL_trajectoryN.csv and GT_trajectoryN.csv, also in folders below.
        part: the number of the run; not needed if there is only one.

    Raises:
        DataError: no such run, or a file of it cannot be used.
        UnknownName: no such run in the folder.
    """
    doppler, reference, number = _files(path, part)
    tables = []
    for file, name, columns in (
        (doppler, "dvl", DOPPLER),
        (reference, "reference", REFERENCE),
    ):
        table = build_table(read_cells(file), name, TIME, "s", columns)
        check_order(table, TIME)
        tables.append(table)
    dvl, raw = tables
    for axis in "yz":
        dvl.columns[f"velocity_body_{axis}"] *= -1.0
    require_finite(raw, list(raw.columns), "the reference")
    truth, velocity = _in_the_map(raw)
    notes = [] if len(raw.stamps) < 2 else [_disagreement(truth, velocity)]
    return RawLog(
        f"{path.name}, run {number}",
        {"dvl": dvl, "reference": truth, "rates": _gyroscope(truth)},
        truth,
        {},
        (doppler, reference),
        tuple(notes),
        "the beginning of the run",
    )


def _in_the_map(raw: Table) -> tuple[Table, np.ndarray]:
    """The reference in east-north-up and forward-left-up; and its velocity in the map."""
    here = raw.columns
    origin = Origin(float(here["latitude"][0]))
    east, north = (float(metres) for metres in origin.scales())
    position = np.stack(
        [
            east * (here["longitude"] - here["longitude"][0]),
            north * (here["latitude"] - here["latitude"][0]),
            here["height"],
        ],
        axis=1,
    )
    angles = np.stack([here["yaw"], here["pitch"], here["roll"]], axis=1)
    turns = Rotation.from_matrix(NED @ Rotation.from_euler("ZYX", angles).as_matrix() @ FRD)
    velocity = np.stack([here["east"], here["north"], -here["down"]], axis=1)
    fields = {
        "position": (position, "m"),
        "velocity_body": (turns.inv().apply(velocity), "m/s"),
    }
    columns, units = {}, {}
    for field, (values, unit) in fields.items():
        for axis, component in zip(AXES, values.T, strict=True):
            columns[f"{field}_{axis}"], units[f"{field}_{axis}"] = component, unit
    for axis, component in zip(AXES + "w", turns.as_quat().T, strict=True):
        columns[f"attitude_{axis}"], units[f"attitude_{axis}"] = component, "1"
    rates = _rates(raw.stamps, turns, raw.stamps)
    return raw._replace(
        columns=columns | {"yaw_rate": rates[:, 2]}, units=units | {"yaw_rate": "rad/s"}
    ), velocity


def _rates(stamps: np.ndarray, turns: Rotation, when: np.ndarray) -> np.ndarray:
    """Angular rates in the body of the smoothest motion through all attitudes."""
    if len(stamps) < 2:
        return np.full((len(when), 3), np.nan)
    return RotationSpline(stamps / SECOND, turns)(when / SECOND, 1)


def _gyroscope(reference: Table) -> Table:
    """What a gyroscope would have said, at 10 Hz."""
    stamps = reference.stamps
    fine = np.arange(stamps[0], stamps[-1] + 1, SECOND // RATE)
    turns = np.stack([reference.columns[f"attitude_{axis}"] for axis in AXES + "w"], axis=1)
    rates, row = _rates(stamps, Rotation.from_quat(turns), fine), np.searchsorted(stamps, fine)
    names = [f"angular_rate_{axis}" for axis in AXES]
    return reference._replace(
        name="rates",
        stamps=fine,
        columns=dict(zip(names, rates.T, strict=True)),
        lines=reference.lines[row],
        units=dict.fromkeys(names, "rad/s"),
    )


def _disagreement(truth: Table, velocity: np.ndarray) -> str:
    """How far the reference's velocity, integrated, misses its own position."""
    position = np.stack([truth.columns[f"position_{axis}"] for axis in AXES], axis=1)
    seconds = np.diff(truth.stamps) / SECOND
    travelled = ((velocity[1:] + velocity[:-1]) / 2 * seconds[:, None]).sum(axis=0)
    gap = float(np.linalg.norm(travelled - (position[-1] - position[0])))
    distance = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    share = f", {100 * gap / distance:.2f} % of {distance:.0f} m" if distance else ""
    return (
        f"reference: its velocity, integrated, misses its own position by {gap:.2f} m{share}; "
        "errors below that say nothing"
    )


def _files(path: Path, part: str | None) -> tuple[Path, Path, str]:
    """The Doppler log and the reference of a run, and its number."""
    if not path.is_dir():
        raise DataError(f"{path}: no such folder, expected one with DVL_trajectoryN.csv")
    by_number: dict[str, Path] = {}
    for file in sorted(path.rglob("DVL_trajectory*.csv*")):
        if match := re.fullmatch(r"DVL_trajectory(\d+)\.csv(\.gz)?", file.name):
            if match[1] in by_number:
                raise DataError(f"{path}: run {match[1]} is there twice, last in {file.parent}")
            by_number[match[1]] = file
    runs = sorted(by_number, key=int)
    if not runs:
        raise DataError(f"{path}: found no DVL_trajectoryN.csv there or in a folder below")
    if part is None:
        if len(runs) > 1:
            choice = ", ".join(f"{path.name}#{run}" for run in runs)
            raise DataError(
                f"{path}: expected a run's number after the path; there are {choice}"
            )
        part = runs[0]
    if part not in by_number:
        raise UnknownName(f"{path}: {unknown('run', part, runs)}")
    doppler = by_number[part]
    reference = doppler.with_name(doppler.name.replace("DVL_", "GT_", 1))
    if not reference.is_file():
        raise DataError(
            f"{reference}: no such file, expected the reference beside {doppler.name}"
        )
    return doppler, reference, part
