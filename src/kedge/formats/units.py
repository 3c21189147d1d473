"""Units and frames of files: the one place where they are converted.

``enu`` is what kedge uses inside: x east, y north, z up, headings from east, positive to the
left. ``ned`` is a map with x north, y east, z down, compass headings from north and a
forward-right-down body, everything positive to the right. The name that a column has inside
says how it is brought to ENU:

* ``NAME_x`` and ``NAME_y`` (also ``_std``) change places, ``NAME_z`` changes its sign;
* with ``body`` in NAME, y and z change their signs instead;
* ``heading`` becomes 90 degrees minus itself, wrapped;
* ``yaw_rate``, ``bearing``, ``steering`` and ``pitch`` change their signs;
* everything else stays; covariances and quaternions are refused.
"""

import math
import re
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError

DEGREE = math.pi / 180
UNITS: dict[str, tuple[str, float]] = {
    "1": ("1", 1.0),
    "%": ("1", 0.01),
    "1/s": ("1/s", 1.0),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "km": ("m", 1e3),
    "ft": ("m", 0.3048),
    "rad": ("rad", 1.0),
    "deg": ("rad", DEGREE),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "km/h": ("m/s", 1 / 3.6),
    "kn": ("m/s", 1852 / 3600),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", DEGREE),
    "m/s^2": ("m/s^2", 1.0),
    "g": ("m/s^2", 9.80665),
    "Pa": ("Pa", 1.0),
    "bar": ("Pa", 1e5),
    "N": ("N", 1.0),
    "N m": ("N m", 1.0),
    # Variances and covariances that come with readings.
    "m^2": ("m^2", 1.0),
    "rad^2": ("rad^2", 1.0),
    "deg^2": ("rad^2", DEGREE**2),
    "m*rad": ("m*rad", 1.0),
    "m^2/s^2": ("m^2/s^2", 1.0),
}
"""Unit in a file -> (SI unit, factor)."""

TIME_UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Unit of time -> power of ten in ns."""


def nanoseconds(number: Decimal, power: int) -> int:
    """A time in ns, rounded; a number beyond 64 bits for whatever 64 bits cannot hold.

    A number of few letters may have a million digits, which nobody should write out.

    Raises:
        ValueError: it is no finite number.
    """
    if not number.is_finite():
        raise ValueError(f"found {number}, expected a finite number")
    if number and number.adjusted() + power > 19:
        return -(2**63) - 1 if number < 0 else 2**63
    return round(number.scaleb(power))


def all_to_enu(
    path: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Bring all columns of a NED source to ENU: values and units by their names there.

    Raises:
        DataError: a column is a covariance or a quaternion.
    """
    turned = {name: to_enu(path, name, units[name], values) for name, values in columns.items()}
    return dict(turned.values()), {new: units[old] for old, (new, _) in turned.items()}


def to_enu(
    path: Path, name: str, unit: str, values: Float[np.ndarray, " n"]
) -> tuple[str, Float[np.ndarray, " n"]]:
    """Bring one NED column to ENU: its name there and its values.

    Raises:
        DataError: it is a covariance or a quaternion, which one column cannot tell.
    """
    if "attitude" in name or "^2" in unit.replace("s^2", "") or "*" in unit:
        raise DataError(
            f"{path}: column {name!r}: cannot be converted from frame 'ned'; write it in 'enu'"
        )
    if axes := re.fullmatch(r"(.+)_([xyz])(_std)?", name):
        stem, axis, std = axes[1], axes[2], axes[3] or ""
        if "body" in stem:
            return name, values if std or axis == "x" else -values
        swapped = {"x": "y", "y": "x", "z": "z"}[axis]
        return f"{stem}_{swapped}{std}", values if std or axis != "z" else -values
    if re.search(r"(^|_)heading$", name):
        return name, (np.pi / 2 - values + np.pi) % (2 * np.pi) - np.pi
    turning = re.search(r"(^|_)(yaw_rate|bearing|steering|pitch)$", name)
    return name, -values if turning else values
