"""Quaternions in messages: what a column of a heading or of an attitude makes of one."""

import math
import re
from typing import Any

import numpy as np

from kedge.core.errors import DataError
from kedge.core.manifolds import Rotation, columns_of

ATTITUDE = "attitude"
ANGLES = ("rad", "deg")
_HEADING = re.compile(r"(^|_)(heading|yaw|orientation)$")


def parts_of(name: str) -> tuple[str, ...]:
    """The columns of a table that a column of a bag becomes: four of an attitude."""
    return columns_of(name, Rotation()) if name == ATTITUDE else (name,)


def quaternion_in(content: Any) -> tuple[Any, ...] | None:
    """(w, x, y, z) of what has fields of these names and no others; None of all else."""
    if isinstance(content, dict):
        return tuple(content[a] for a in "wxyz") if content.keys() == set("wxyz") else None
    if all(hasattr(content, axis) for axis in "wxyz"):
        return tuple(getattr(content, axis) for axis in "wxyz")
    return None


def turn_of(name: str, unit: str, quaternion: tuple[Any, ...], place: str) -> tuple[float, ...]:
    r"""A heading, $\operatorname{atan2}(2(wz + xy), 1 - 2(y^2 + z^2))$ in rad, or an attitude.

    All zeros are what a message says that was never filled: the reading lacks it.

    Raises:
        DataError: no rotation, or a column that no quaternion can fill.
    """
    attitude = name == ATTITUDE
    if not attitude and not _HEADING.search(name):
        raise DataError(
            f"{place}: found a quaternion, expected a number; a quaternion fills a column "
            "called heading (in rad) or attitude"
        )
    if unit != (expected := "1" if attitude else "rad"):
        raise DataError(
            f"{place}: {name} from a quaternion: found unit {unit!r}, expected {expected!r}"
        )
    try:
        turn = np.array([float(part) for part in quaternion])
    except (TypeError, ValueError):
        raise DataError(f"{place}: found {quaternion}, expected a quaternion") from None
    length = float(np.linalg.norm(turn))
    if length == 0 or math.isnan(length):
        return (math.nan,) * (4 if attitude else 1)
    if abs(length - 1) > 0.01:
        raise DataError(f"{place}: found a quaternion of length {length:.6g}, expected 1")
    w, x, y, z = (turn / length).tolist()
    if attitude:
        return w, x, y, z
    return (math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),)
