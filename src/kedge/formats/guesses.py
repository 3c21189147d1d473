"""What the columns of a file seem to be, by their names and by how large their numbers are."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.formats.units import UNITS


class Guess(NamedTuple):
    """A column: what kedge would call it, its unit, and why."""

    name: str
    unit: str
    why: str


_AXIS = r"_?([xyz])$"
_ALL = r"(?:\w+_)?"
RULES: tuple[tuple[str, str, str], ...] = tuple(
    (rf"^{pattern}", name, si)
    for pattern, name, si in (
        (rf"{_ALL}(latitude|lat)$", "latitude", "rad"),
        (rf"{_ALL}(longitude|long|lng|lon)$", "longitude", "rad"),
        (rf"{_ALL}(altitude|alt)$", "altitude", "m"),
        (rf"{_ALL}covariance.*", "", ""),
        (rf"{_ALL}(yaw_?rate|turn_?rate)$", "yaw_rate", "rad/s"),
        (rf"{_ALL}(gyr\w*|angular\w*|omega|w|w_rs_s){_AXIS}", "angular_rate_{}", "rad/s"),
        (
            rf"{_ALL}(acc\w*|linear_acc\w*|specific_force|a|a_rs_s){_AXIS}",
            "specific_force_{}",
            "m/s^2",
        ),
        (rf"{_ALL}(orientation|rotation|attitude|quat\w*|q)_?([wxyz])$", "attitude_{}", "1"),
        (rf"{_ALL}(dvl|velocity_body|v_body|body_velocity){_AXIS}", "velocity_body_{}", "m/s"),
        (rf"{_ALL}twist_linear_x$", "speed", "m/s"),
        (rf"{_ALL}twist_linear_y$", "sideways", "m/s"),
        (rf"{_ALL}(velocity|vel|v)_?north$", "velocity_north", "m/s"),
        (rf"{_ALL}(velocity|vel|v)_?east$", "velocity_east", "m/s"),
        (rf"{_ALL}(velocity|vel|v)_?(down|up)$", "velocity_{}", "m/s"),
        (rf"{_ALL}(velocity|vel|v){_AXIS}", "velocity_{}", "m/s"),
        (rf"{_ALL}(left|left_speed|speed_left|v_?l)$", "left", "m/s"),
        (rf"{_ALL}(right|right_speed|speed_right|v_?r)$", "right", "m/s"),
        (rf"{_ALL}(steer\w*|delta)$", "steering", "rad"),
        (rf"{_ALL}(speed|velocity|vel|v)$", "speed", "m/s"),
        (rf"{_ALL}(omega|w)$", "yaw_rate", "rad/s"),
        (rf"{_ALL}(heading|yaw|psi|theta|heading_degrees)$", "heading", "rad"),
        (rf"{_ALL}(roll|pitch)$", "{}", "rad"),
        (rf"{_ALL}bearing$", "bearing", "rad"),
        (rf"{_ALL}(range|dist|distance|distancefromtag)$", "range", "m"),
        (rf"(\w+_)?(p|pos|position|translation|point|p_rs_r){_AXIS}", "position_{}", "m"),
        (rf"{_ALL}x$|east$|easting$", "position_x", "m"),
        (rf"{_ALL}y$|north$|northing$", "position_y", "m"),
        (rf"{_ALL}z$|up$", "position_z", "m"),
    )
)
TARGET = re.compile(r"^(\w+_)?(id|anchor|beacon|landmark|target|post|subject)$")
TIME = re.compile(r"^(\w+_)?(time|timestamp|stamp|t|time_s|secs?|seconds)$")
SUFFIXES = {"_deg": "deg", "_degrees": "deg", "_rad": "rad", "_mm": "mm", "_cm": "cm"}
STARTS = {"rad": ("deg", 2.2 * np.pi), "rad/s": ("deg/s", 35.0)}
"""Of an SI unit: what is meant if numbers are larger than this."""


def plain(header: str) -> str:
    """A column's name as rules know it: small letters, no unit in brackets."""
    text = re.sub(r"\[.*\]|\(.*\)", "", header).strip(" #%").lower()
    return re.sub(r"\W+", "_", text).strip("_").removeprefix("field_")


def written_unit(header: str) -> str | None:
    """The unit that a header has in brackets or at its end, if it is one of ours."""
    bracket = re.search(r"[\[(]([^\])]+)[\])]", header)
    if bracket:
        text = re.sub(r"\s*s\^-(\d)", r"/s^\1", bracket[1]).replace("s^1", "s")
        text = text.replace("°", "deg").strip()
        return text if text in UNITS else None
    low = header.lower()
    return next((unit for end, unit in SUFFIXES.items() if low.endswith(end)), None)


def guess(header: str, values: Float[np.ndarray, " n"] | None) -> Guess | None:
    """What a column of numbers may be; None if its name says nothing.

    Without values it is in SI units.
    """
    name = plain(header)
    for suffix in SUFFIXES:
        name = name.removesuffix(suffix) if f"heading{suffix}" != name else "heading"
    for pattern, template, si in RULES:
        match = re.match(pattern, name)
        if match is None:
            continue
        if not template:
            return None
        inside = template.format(match.groups()[-1]) if "{}" in template else template
        return Guess(inside, *_unit(header, si, values))
    return None


def _unit(header: str, si: str, values: Float[np.ndarray, " n"] | None) -> tuple[str, str]:
    if values is None:
        return si, "SI, as messages have it"
    unit = written_unit(header)
    if unit is not None and UNITS[unit][0] == si:
        return unit, "unit as in its name"
    finite = np.abs(values[np.isfinite(values)])
    largest = float(finite.max()) if len(finite) else 0.0
    if si in STARTS and largest > STARTS[si][1]:
        return STARTS[si][0], f"up to {largest:.4g}: too large for {si}"
    return si, f"unit not said; up to {largest:.4g}"


COMPASS = {
    True: {"north": "x", "east": "y", "down": "z"},
    False: {"east": "x", "north": "y", "up": "z"},
}
"""The axes of velocities by the points of the compass, in NED and in ENU."""


def compassed(columns: dict[str, Guess]) -> tuple[dict[str, Guess], bool]:
    """The guesses with axes for the points of the compass; whether the frame is NED."""
    ned = any(guessed.name == "velocity_down" for guessed in columns.values())
    turned = {}
    for column, guessed in columns.items():
        stem, _, point = guessed.name.rpartition("_")
        axis = COMPASS[ned].get(point) if stem == "velocity" else None
        turned[column] = guessed._replace(name=f"velocity_{axis}") if axis else guessed
    return turned, ned


def weighed(
    columns: dict[str, Guess], numbers: Mapping[str, Float[np.ndarray, " n"]]
) -> dict[str, Guess]:
    """The guesses, with specific forces in g if together they weigh no more than a few."""
    forces = [c for c, g in columns.items() if g.name[:14] == "specific_force"]
    if not forces or any(written_unit(column) for column in forces):
        return columns
    size = float(np.nanmedian(np.linalg.norm([numbers[c] for c in forces], axis=0)))
    if size > 4.0:
        return columns
    why = f"{size:.3g} in the median: gravity is 1 g"
    return columns | {c: columns[c]._replace(unit="g", why=why) for c in forces}


def time_unit(header: str, values: Float[np.ndarray, " n"]) -> str:
    """The unit of a column of times: as written, or by today's Unix time in it."""
    written = re.search(r"[\[(](ns|us|ms|s)[\])]|_(ns|us|ms)$", header)
    if written:
        return written[1] or written[2]
    size = float(np.nanmedian(np.abs(values)))
    return "ns" if size > 1e17 else "us" if size > 1e14 else "ms" if size > 1e11 else "s"
