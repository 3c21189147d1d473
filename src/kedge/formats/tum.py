"""TUM trajectory files: ``timestamp tx ty tz qx qy qz qw``, what most evaluation tools read.

Stamps are int64 nanoseconds here and decimal seconds in the file. They never pass through a
float, which at today's Unix time resolves 240 ns.
"""

import os
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64

from kedge.core.errors import DataError
from kedge.formats.atomic import replace_file
from kedge.formats.units import nanoseconds

COLUMNS = "timestamp tx ty tz qx qy qz qw"


class TumPoses(NamedTuple):
    """What a TUM file holds, with quaternions as kedge orders them (w, x, y, z)."""

    time: Int64[np.ndarray, " T"]  # ns
    position: Float[np.ndarray, "T 3"]  # m
    orientation: Float[np.ndarray, "T 4"]


def write_tum(
    path: str | os.PathLike[str],
    time: Int64[np.ndarray, " T"],
    position: Float[np.ndarray, "T d"],
    orientation: Float[np.ndarray, " T"] | Float[np.ndarray, "T 4"] | None = None,
) -> None:
    """Write poses, all or nothing: the new file replaces an old one once it is complete.

    Planar positions lie at z = 0. A heading psi is the quaternion (cos psi/2, 0, 0, sin psi/2);
    without orientation every pose has the identity. Numbers are the shortest that read back
    as the same float.

    Args:
        path: the file.
        time: stamps in ns.
        position: planar or spatial positions in m.
        orientation: headings in rad or quaternions (w, x, y, z).

    Raises:
        DataError: the arrays do not fit together, a value is not finite, or the file cannot be
            written.
    """
    count = len(time)
    if position.shape not in ((count, 2), (count, 3)):
        raise DataError(
            f"position: found {position.shape}, expected ({count}, 2) or ({count}, 3)"
        )
    if orientation is not None and orientation.shape not in ((count,), (count, 4)):
        raise DataError(
            f"orientation: found {orientation.shape}, expected ({count},) or ({count}, 4)"
        )
    poses = np.zeros((count, 7))
    poses[:, : position.shape[1]] = position
    if orientation is None:
        poses[:, 6] = 1.0
    elif orientation.ndim == 1:
        poses[:, 5], poses[:, 6] = np.sin(orientation / 2), np.cos(orientation / 2)
    else:
        poses[:, 3:] = orientation[:, [1, 2, 3, 0]]
    if not np.all(np.isfinite(poses)):
        row = int(np.argmin(np.all(np.isfinite(poses), axis=1)))
        raise DataError(f"pose {row}, {_seconds(int(time[row]))} s, is not finite")
    lines = [f"# {COLUMNS}"]
    for stamp, pose in zip(time.tolist(), poses.tolist(), strict=True):
        lines.append(" ".join([_seconds(stamp), *map(repr, pose)]))
    replace_file(Path(path), ("\n".join(lines) + "\n").encode())


def read_tum(path: str | os.PathLike[str]) -> TumPoses:
    """Read poses; blank lines and lines that start with # are skipped.

    Stamps are rounded to the nanosecond, quaternions brought to unit length.

    Raises:
        DataError: the file cannot be read, holds no pose, or a line (the message says which)
            has not eight finite numbers, no unit quaternion, or a stamp before the last one's.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as a TUM trajectory: {error}") from error
    return parse_tum(path, text)


def parse_tum(path: str | os.PathLike[str], text: str) -> TumPoses:
    """The poses of a file's text.

    Raises:
        DataError: as for :func:`read_tum`.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            stamp, row = _parsed(fields)
            if stamps and stamp < stamps[-1]:
                raise DataError(f"found stamp {fields[0]}, expected none before the last one's")
        except DataError as error:
            raise DataError(f"{path}:{number}: {error}") from error
        stamps.append(stamp)
        rows.append(row)
    if not rows:
        raise DataError(f"{path}: found no pose, expected lines of {COLUMNS}")
    poses = np.array(rows)
    turns = poses[:, [6, 3, 4, 5]]
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return TumPoses(np.array(stamps, dtype=np.int64), poses[:, :3], turns)


def _parsed(fields: list[str]) -> tuple[int, list[float]]:
    if len(fields) != 8:
        raise DataError(f"found {len(fields)} fields, expected 8: {COLUMNS}")
    try:
        stamp = nanoseconds(Decimal(fields[0]), 9)
        row = [float(field) for field in fields[1:]]
    except (ValueError, ArithmeticError) as error:
        raise DataError(f"found {' '.join(fields)!r}, expected eight numbers") from error
    if not np.all(np.isfinite(row)):
        raise DataError(f"found {' '.join(fields)!r}, expected finite numbers")
    if not -(2**63) <= stamp < 2**63:
        raise DataError(f"found stamp {fields[0]}, expected seconds, not another unit")
    # Files with few digits are off by 1e-4 or so; what is further off is no rotation.
    if abs((length := float(np.linalg.norm(row[3:]))) - 1) > 0.01:
        raise DataError(f"found a quaternion of length {length:.6g}, expected 1")
    return stamp, row


def _seconds(stamp: int) -> str:
    whole, nanoseconds = divmod(abs(stamp), 1_000_000_000)
    return f"{'-' if stamp < 0 else ''}{whole}.{nanoseconds:09d}"
