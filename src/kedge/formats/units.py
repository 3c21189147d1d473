"""Units and frames of files: the one place where they are converted.

``enu`` is what kedge uses inside: x east, y north, z up, headings from east, positive to the
left. ``ned`` is a map with x north, y east, z down, compass headings from north and a
forward-right-down body, everything positive to the right. The name that a column has inside
says how it is brought to ENU:

* ``NAME_x`` and ``NAME_y`` (also ``_std``) change places, ``NAME_z`` changes its sign;
* with ``body`` in NAME, y and z change their signs instead;
* ``heading`` becomes 90 degrees minus itself, wrapped;
* ``yaw_rate``, ``bearing``, ``steering`` and ``pitch`` change their signs;
* ``NAME_w`` to ``NAME_z`` is a quaternion, turned as a whole
  (:func:`kedge.formats.attitudes.from_ned`);
* everything else stays. So do covariances, which know their components only in a rig:
  :func:`is_covariance` tells them, and who reads them turns them by :func:`axis_in_enu`.
"""

import math
import re
from collections import Counter
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.core.registry import unknown

DEGREE = math.pi / 180
LONGEST = 100
"""Letters of a product of units: what is longer is none, and may be nested too deeply."""
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
}
"""Unit in a file -> (SI unit, factor); :func:`unit_of` knows their products too."""

TIME_UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Unit of time -> power of ten in ns."""


def unit_of(text: str) -> tuple[str, float]:
    """SI unit and factor of a unit, or of a product with powers: ``(rad/s)^2``, ``m^2/s^4``.

    The sign of degrees is ``deg``. Products come out in one spelling, so that two which are
    the same unit are the same text.

    Raises:
        DataError: it is none.
    """
    text = text.replace("°", "deg")
    if text in UNITS:
        return UNITS[text]
    try:
        if len(text) > LONGEST:
            raise ValueError
        powers, factor = _Product(text).read()
    except (ValueError, KeyError, OverflowError):
        raise DataError(
            f"{unknown('unit', text, list(UNITS))}, and products of these such as m^2, "
            "(rad/s)^2 or m^2/s^4"
        ) from None
    above, below = (
        [
            f"{unit}^{abs(n)}" if abs(n) > 1 else unit
            for unit, n in sorted(powers.items())
            if keep(n)
        ]
        for keep in (lambda n: n > 0, lambda n: n < 0)
    )
    return "/".join(["*".join(above) or "1", *below]), factor


def product_of(first: str, second: str) -> str:
    """The SI unit of a covariance of two quantities."""
    return unit_of(f"({first})*({second})")[0]


class _Product:
    """A product of units, read from left to right."""

    def __init__(self, text: str):
        self.tokens = re.findall(r"[A-Za-z%]+|\^-?\d|[()*/1]|\S", text.replace("²", "^2"))

    def read(self) -> tuple[Counter[str], float]:
        powers, factor = self._factors()
        if self.tokens:
            raise ValueError(self.tokens)
        return Counter({unit: n for unit, n in powers.items() if n}), factor

    def _factors(self) -> tuple[Counter[str], float]:
        powers, factor, sign = Counter(), 1.0, 1
        while True:
            more, scale = self._power()
            for unit, n in more.items():
                powers[unit] += sign * n
            factor *= scale**sign
            if not self.tokens or self.tokens[0] == ")":
                return powers, factor
            sign = {"/": -1}.get(self.tokens[0], 1)
            if self.tokens[0] in "*/":
                self.tokens.pop(0)

    def _power(self) -> tuple[Counter[str], float]:
        token = self.tokens.pop(0) if self.tokens else ""
        if token == "(":
            powers, factor = self._factors()
            if not self.tokens or self.tokens.pop(0) != ")":
                raise ValueError("a bracket that is not closed")
        else:
            unit, factor = UNITS[token]
            # What is no atom in SI (g) is a product of atoms.
            atom = unit == token or unit.isalpha()
            powers = Counter({unit: 1}) if atom else _Product(unit).read()[0]
            powers.pop("1", None)
        power = int(self.tokens.pop(0)[1:]) if self.tokens and self.tokens[0][0] == "^" else 1
        return Counter({u: n * power for u, n in powers.items()}), factor**power


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


def is_covariance(unit: str) -> bool:
    """Whether it is a product of units, as covariances have it."""
    return "^2" in unit.replace("s^2", "") or "*" in unit


def axis_in_enu(path: Path, name: str, unit: str) -> tuple[str, float]:
    """Which component an NED component is in ENU, and its sign there.

    Raises:
        DataError: it is a part of an attitude.
    """
    inside, (zero, one) = to_enu(path, name, unit, np.array([0.0, 1.0]))
    return inside, float(np.sign(one - zero))


def to_enu(
    path: Path, name: str, unit: str, values: Float[np.ndarray, " n"]
) -> tuple[str, Float[np.ndarray, " n"]]:
    """Bring one NED column to ENU: its name there and its values.

    Raises:
        DataError: it is a part of a quaternion, which one column cannot tell.
    """
    if is_covariance(unit):
        return name, values
    if "attitude" in name:
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
