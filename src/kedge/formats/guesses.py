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
# English, and German as plants and trucks of that tongue write it.
RULES: tuple[tuple[str, str, str], ...] = tuple(
    (rf"^{pattern}", name, si)
    for pattern, name, si in (
        (rf"{_ALL}(latitude|lat|breite|breitengrad)$", "latitude", "rad"),
        (rf"{_ALL}(longitude|long|lng|lon|länge|längengrad)$", "longitude", "rad"),
        (rf"{_ALL}(altitude|alt|höhe)$", "altitude", "m"),
        (rf"{_ALL}covariance.*", "", ""),
        (rf"{_ALL}(yaw_?rate|turn_?rate|drehrate|gierrate)$", "yaw_rate", "rad/s"),
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
        (rf"{_ALL}(steer\w*|delta|lenkwinkel)$", "steering", "rad"),
        (rf"{_ALL}(speed|velocity|vel|v|geschwindigkeit)$", "speed", "m/s"),
        (rf"{_ALL}(omega|w)$", "yaw_rate", "rad/s"),
        (rf"{_ALL}(heading|yaw|psi|theta|heading_degrees|kurs|gierwinkel)$", "heading", "rad"),
        (rf"{_ALL}(roll|pitch)$", "{}", "rad"),
        (rf"{_ALL}(bearing|peilung)$", "bearing", "rad"),
        (rf"{_ALL}(range|dist|distance|distancefromtag|abstand|entfernung)$", "range", "m"),
        (rf"(\w+_)?(p|pos|position|translation|point|p_rs_r){_AXIS}", "position_{}", "m"),
        (rf"{_ALL}x$", "position_x", "m"),
        (rf"{_ALL}y$", "position_y", "m"),
        (rf"{_ALL}z$", "position_z", "m"),
        (r"(east|easting|ost|rechtswert)$", "position_east", "m"),
        (r"(north|northing|nord|hochwert)$", "position_north", "m"),
        (r"(down|up)$", "position_{}", "m"),
        (rf"{_ALL}(depth|tiefe)$", "depth", "m"),
    )
)
TARGET = re.compile(r"^(\w+_)?(id|anchor|anker|beacon|landmark|target|post|subject)$")
TIME = re.compile(
    r"^(\w+_)?(time|timestamp|stamp|t|secs?|seconds|epoch|unix|utc|zeit|zeitstempel)"
    r"(_(s|ms|us|ns))?$"
)
SUFFIXES = {
    "_deg": "deg",
    "_degrees": "deg",
    "_rad": "rad",
    "_mm": "mm",
    "_cm": "cm",
    "_kmh": "km/h",
    "_kph": "km/h",
    "_mps": "m/s",
    "_dps": "deg/s",
    "_kn": "kn",
    "_knots": "kn",
}
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
"""The axes by the points of the compass, in NED and in ENU."""
TURNING = ("roll", "pitch", "heading")


def compassed(columns: dict[str, Guess]) -> tuple[dict[str, Guess], bool]:
    """The guesses with axes for the points of the compass; whether the frame is NED."""
    ned = any(guessed.name.endswith("_down") for guessed in columns.values())
    turned: dict[str, Guess] = {}
    for column, guessed in columns.items():
        stem, _, point = guessed.name.rpartition("_")
        axis = COMPASS[ned].get(point) if stem in ("velocity", "position") else None
        name = f"{stem}_{axis}" if axis else guessed.name
        if name not in {other.name for other in turned.values()}:  # both x and east
            turned[column] = guessed._replace(name=name)
    return turned, ned


def in_one_unit(columns: dict[str, Guess]) -> dict[str, Guess]:
    """The guesses, with roll and pitch in degrees where a heading is too large for radians."""
    large = [c for c, g in columns.items() if g.name in TURNING and g.unit == "deg"]
    if not large:
        return columns
    why = f"as {large[0]} is"
    small = {c: g for c, g in columns.items() if g.name in TURNING and "not said" in g.why}
    return columns | {c: g._replace(unit="deg", why=why) for c, g in small.items()}


def ticks(
    columns: dict[str, Guess], numbers: Mapping[str, Float[np.ndarray, " n"]]
) -> dict[str, Guess]:
    """The guesses, with counts of encoders where wheels tell large whole numbers."""
    wheels = [c for c, g in columns.items() if g.name in ("left", "right")]
    told = np.concatenate([numbers[c] for c in wheels]) if wheels else np.zeros(1)
    told = told[np.isfinite(told)]
    if not (np.all(told == np.round(told)) and np.max(np.abs(told), initial=0.0) > 50.0):
        return columns
    why = "whole numbers: ticks"
    return columns | {c: columns[c]._replace(unit="1", why=why) for c in wheels}


def counts_from_north(
    columns: Mapping[str, Guess], numbers: Mapping[str, Float[np.ndarray, " n"]]
) -> bool:
    """Whether a heading beside places in ENU is a compass's, by where the vehicle goes.

    A heading from north, positive to the right, follows the way where one from east does not.
    """
    by_name = {g.name: numbers[c] * UNITS[g.unit][1] for c, g in columns.items()}
    if {"latitude", "longitude"} <= by_name.keys():
        east = by_name["longitude"] * np.cos(by_name["latitude"])
        by_name |= {"position_x": east, "position_y": by_name["latitude"]}
    if not {"position_x", "position_y", "heading"} <= by_name.keys():
        return False
    way = np.diff(by_name["position_x"] + 1j * by_name["position_y"])
    heading = by_name["heading"][:-1]
    gone = np.isfinite(way) & np.isfinite(heading)
    way, heading = way[gone], heading[gone]
    if not (length := np.abs(way).sum()):
        return False
    mathematical, compass = (
        float(np.real(way * np.exp(-1j * angle)).sum() / length)
        for angle in (heading, np.pi / 2 - heading)
    )
    return compass > 0.7 and compass > mathematical + 0.3


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
