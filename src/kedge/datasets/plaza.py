"""The CMU "Plaza" sets: a mower with odometer, gyroscope and ranging radios, and RTK truth.

Matrices of a MATLAB file: ``GT`` (time, x, y, heading), ``DR`` (time, distance and turn since
the row before), ``TD`` (time, antenna, beacon, range), ``TL`` (beacon, x, y).

Source: J. Djugash, B. Hamner, S. Roth, "Navigating with ranging radios: five data sets with
ground truth", Journal of Field Robotics 26(9), 2009.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.core.registry import readers
from kedge.estimation.log import SECOND
from kedge.formats.logs import RawLog, TargetMap
from kedge.formats.matlab import read_matrix
from kedge.formats.tables import in_order, stamps_of, table_of

SHAPES = {"GT": 4, "DR": 3, "TD": 4, "TL": 3}
"""Matrix -> how many columns it has."""


@readers.add("plaza")
def read_plaza(path: Path, part: str | None = None) -> RawLog:
    """Read one ``.mat`` file.

    Distances and turns become speed and yaw rate over the time since the row before. A truth
    whose heading is opposite to its own travel is turned round, and ``notes`` says so.

    Raises:
        DataError: the file cannot be read, or a matrix is missing or of another shape.
    """
    if part is not None:
        raise DataError(f"{path}: found part {part!r}, but the file holds one drive")
    known, moved, ranges, beacons = (_matrix(path, name) for name in SHAPES)
    notes: list[str] = []

    stamps = stamps_of(path, "DR", moved[:, 0])
    before = np.concatenate([[2 * stamps[0] - stamps[1]], stamps[:-1]])
    span = (stamps - before) / SECOND
    if not (span > 0).all():
        at = int(np.argmin(span > 0))
        raise DataError(f"{path}: DR: row {at + 1}: found time that does not go forwards")
    odometry = table_of(
        "odometry",
        path,
        before,
        {"speed": (moved[:, 1] / span, "m/s"), "yaw_rate": (moved[:, 2] / span, "rad/s")},
    )
    radio = table_of(
        "radio",
        path,
        stamps_of(path, "TD", ranges[:, 0]),
        {"range": (ranges[:, 3], "m")},
        {"target": [str(int(beacon)) for beacon in ranges[:, 2]]},
    )
    heading = _forward(known, notes)
    truth = table_of(
        "truth",
        path,
        stamps_of(path, "GT", known[:, 0]),
        {
            "position_x": (known[:, 1], "m"),
            "position_y": (known[:, 2], "m"),
            "heading": (heading, "rad"),
        },
    )
    targets = TargetMap(
        tuple(str(int(beacon)) for beacon in beacons[:, 0]),
        {"position_x": beacons[:, 1], "position_y": beacons[:, 2]},
        {"position_x": "m", "position_y": "m"},
    )
    tables = {"odometry": odometry, "radio": in_order(radio, notes)}
    return RawLog(
        path.stem.rstrip("_"),
        tables,
        in_order(truth, notes),
        {"beacons": targets},
        (path,),
        tuple(notes),
    )


def _matrix(path: Path, name: str) -> Float[np.ndarray, "n k"]:
    values, wanted = read_matrix(path, name), SHAPES[name]
    if values.ndim != 2 or values.shape[1] != wanted or len(values) < 2:
        raise DataError(
            f"{path}: {name}: found shape {values.shape}, expected rows of {wanted} numbers"
        )
    if not np.isfinite(values).all():
        at = int(np.argmin(np.isfinite(values).all(axis=1)))
        raise DataError(f"{path}: {name}: row {at + 1}: expected finite numbers")
    return values


def _forward(known: Float[np.ndarray, "n 4"], notes: list[str]) -> Float[np.ndarray, " n"]:
    """The truth's heading along its own travel: in one of the sets it is opposite."""
    step, heading = np.diff(known[:, 1:3], axis=0), known[:-1, 3]
    along = step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)
    if along.sum() >= 0:
        return known[:, 3]
    notes.append("truth: its heading was opposite to its travel and was turned by half a turn")
    return known[:, 3] + np.pi
