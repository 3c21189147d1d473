"""EuRoC's flying robot: an IMU, and the trajectory that was found for it afterwards.

A copy that went through a spreadsheet is read up to its first row that is none; its stamps lost
their last digits and are brought back to the grid of their period.

Source: M. Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 35(10), 2016.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import readers
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table
from kedge.formats.text import read_text
from kedge.formats.tum import parse_tum

UNITS = {f"angular_rate_{axis}": "rad/s" for axis in "xyz"} | {
    f"specific_force_{axis}": "m/s^2" for axis in "xyz"
}
"""In the order of the file's columns, which are in the body's axes as they are."""
PERIOD = 5_000_000  # ns
COARSE = 10_000  # ns; what 15 digits leave of a stamp


@readers.add("euroc_mh01_imu")
def read_euroc(path: Path, part: str | None = None) -> RawLog:
    """Read the IMU (``imu0_data.csv``) and the truth (``*_gt_tum.txt``) of a folder.

    The true velocity is the central difference of the true positions.

    Raises:
        DataError: a file is missing or cannot be used.
        UnknownName: a part was asked for; there are none.
    """
    if part is not None:
        raise UnknownName(f"{path}: found part {part!r}, expected none: there is one IMU")
    if not path.is_dir():
        raise DataError(f"{path}: no such folder, expected imu0_data.csv and a truth in it")
    notes: list[str] = []
    imu = _imu(_file(path, "imu0_data.csv"), notes)
    truth = _truth(_file(path, "*_gt_tum.txt"))
    return RawLog(
        "EuRoC MH_01_easy",
        {"imu": imu},
        truth,
        {},
        (imu.path, truth.path),
        tuple(notes),
        "Unix",
    )


def _file(folder: Path, name: str) -> Path:
    files = sorted([*folder.glob(name), *folder.glob(f"{name}.gz")])
    if len(files) != 1:
        raise DataError(f"{folder}: found {len(files)} files {name}, expected one (or .gz)")
    return files[0]


def _imu(path: Path, notes: list[str]) -> Table:
    stamps, rows, lines = [], [], []
    text = read_text(path).splitlines()
    for number, line in enumerate(text[1:], start=2):
        cells = line.split(",")
        try:
            row = [float(cell) for cell in cells[1:]]
            stamp = int(cells[0]) if cells[0].isdigit() else round(float(cells[0]))
            np.int64(stamp)  # or it is too large
        except (ValueError, OverflowError):
            row, stamp = [], 0
        if len(row) != len(UNITS) or not np.isfinite(row).all():
            notes.append(
                f"{path.name}: {len(text) + 1 - number} lines from {number} on left out"
            )
            break
        stamps.append(stamp)
        rows.append(row)
        lines.append(number)
    if len(rows) < 2:
        raise DataError(f"{path}:2: found no two rows of 7 numbers, expected an IMU's readings")
    exact = _on_grid(np.array(stamps, np.int64), path, notes)
    if (np.diff(exact) <= 0).any():
        line = lines[int(np.argmax(np.diff(exact) <= 0)) + 1]
        raise DataError(
            f"{path}:{line}: found a time that does not rise, expected one that does"
        )
    values = np.array(rows)
    columns = {name: np.ascontiguousarray(values[:, at]) for at, name in enumerate(UNITS)}
    return Table("imu", path, exact, columns, {}, np.array(lines), dict(UNITS))


def _on_grid(
    stamps: Int64[np.ndarray, " n"], path: Path, notes: list[str]
) -> Int64[np.ndarray, " n"]:
    """Stamps with their last digits again, if they lost them and lie on the grid without."""
    if (stamps % COARSE != 0).any():
        return stamps
    counts = np.round((stamps - stamps[0]) / PERIOD).astype(np.int64)
    exact = stamps[0] + counts * PERIOD
    if np.abs(exact - stamps).max() > COARSE:
        return stamps
    notes.append(f"{path.name}: stamps of {COARSE} ns were brought to steps of {PERIOD} ns")
    return exact


def _truth(path: Path) -> Table:
    poses = parse_tum(path, read_text(path))
    columns: dict[str, Float[np.ndarray, " n"]] = {}
    units = {}
    seconds = (poses.time - poses.time[0]) / 1e9
    if len(seconds) < 2 or (np.diff(seconds) <= 0).any():
        raise DataError(f"{path}: expected two poses or more, each later than the one before")
    velocity = np.gradient(poses.position, seconds, axis=0)
    for name, values, unit, axes in (
        ("position", poses.position, "m", "xyz"),
        ("velocity", velocity, "m/s", "xyz"),
        ("attitude", poses.orientation, "1", "wxyz"),
    ):
        for at, axis in enumerate(axes):
            columns[f"{name}_{axis}"] = np.ascontiguousarray(values[:, at])
            units[f"{name}_{axis}"] = unit
    lines = np.arange(1, len(poses.time) + 1)
    return Table("truth", path, poses.time, columns, {}, lines, units)
