"""ROS 1 and ROS 2 bags and MCAP files as logs, by what the rig file says of their topics.

format = "bag"

[bag.topics.radio]
topic = "/uwb"
each = "ranges"                # one row for each element of this list
target = "id"
columns = { range = { field = "distance", unit = "m" } }
"""

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from kedge.core.errors import ConfigError, DataError
from kedge.core.registry import readers
from kedge.formats.bag_config import BagConfig, FieldConfig, TopicConfig
from kedge.formats.bag_frames import TOPIC as FRAMES
from kedge.formats.bag_frames import frame_in, frames_of, plain_frame
from kedge.formats.bag_messages import Bag, Message, open_bag
from kedge.formats.bag_turns import ANGLES, ATTITUDE, parts_of, quaternion_in, turn_of
from kedge.formats.logs import RawLog, TargetMap, checked_map
from kedge.formats.tables import MOST_DISORDER, Table, in_order, table_of
from kedge.formats.times import TimeForm
from kedge.formats.units import unit_of

STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


class Rows:
    """What is gathered of one topic."""

    def __init__(self, spec: TopicConfig):
        self.spec = spec
        self.stamps: list[int] = []
        self.lines: list[int] = []
        self.targets: list[str] = []
        self.units = {
            part: column.unit
            for name, column in spec.columns.items()
            for part in parts_of(name)
        }
        self.values: dict[str, list[float]] = {name: [] for name in self.units}
        self.count = 0
        self.frame = ""

    def add(self, path: Path, message: Message, timed: bool) -> None:
        """The rows of one message.

        Raises:
            DataError: it cannot be decoded, or has no such field.
        """
        self.count += 1
        place = f"{path}: topic {message.topic!r} ({message.type}), message {self.count}"
        content = _decoded(message, place)
        spec, stamp = self.spec, 0
        self.frame = self.frame or frame_in(content)
        if timed:
            stamp = message.time if spec.stamp == "bag" else _stamp(content, spec, place)
            stamp += round(spec.offset * 1e9)
            if not -(2**63) <= stamp < 2**63:
                raise DataError(
                    f"{place}: {spec.stamp!r}: found a time beyond 292 years from 0, expected "
                    f"one in {spec.stamp_unit}"
                )
        elements = [content] if spec.each is None else _find(content, spec.each, place)
        if not isinstance(elements, Sequence | np.ndarray) or isinstance(elements, str):
            kind = type(elements).__name__
            raise DataError(f"{place}: {spec.each!r}: found a {kind}, expected a list")
        for element in elements:
            self.stamps.append(stamp)
            self.lines.append(self.count)
            if spec.target is not None:
                self.targets.append(str(_find(element, spec.target, place)))
            for name, column in spec.columns.items():
                numbers = _numbers(name, element, column, place)
                for part, value in zip(parts_of(name), numbers, strict=True):
                    self.values[part].append(value)

    def columns(self) -> dict[str, tuple[Float[np.ndarray, " n"], str]]:
        """Values and units by column."""
        return {n: (np.array(v, float), self.units[n]) for n, v in self.values.items()}


@readers.add("bag")
@readers.add("mcap")
def read_bag(path: Path, part: str | None, config: BagConfig | None) -> RawLog:
    """Read the topics that a rig names.

    Raises:
        ConfigError: the rig names none.
        DataError: the bag cannot be read, has no such topic, or a message has no such field;
            the message lists what there is.
    """
    if config is None:
        raise ConfigError(
            "bag: this table is missing; a rig for bags says which topic is what: "
            "[bag.topics.NAME] with topic and columns"
        )
    if part is not None:
        raise DataError(f"{path}: found part {part!r}, but a bag is one log")
    wanted = config.topics | {f"map {name}": spec for name, spec in config.maps.items()}
    with open_bag(path) as bag:
        _check_topics(path, bag, wanted)
        gathered = {name: Rows(spec) for name, spec in wanted.items()}
        by_topic: dict[str, list[str]] = {}
        for name, spec in wanted.items():
            by_topic.setdefault(spec.topic, []).append(name)
        fixed = {FRAMES} & bag.topics.keys() if config.base else set()
        transforms = []
        for message in bag.messages(set(by_topic) | fixed):
            if message.topic in fixed:
                transforms.append(_decoded(message, f"{path}: topic {FRAMES!r}"))
            for name in by_topic.get(message.topic, ()):
                mapped = name not in config.topics
                if not mapped or not gathered[name].count:
                    gathered[name].add(path, message, not mapped)
    try:
        frames = frames_of(transforms, plain_frame(config.base))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path}: topic {FRAMES!r}: expected messages like tf2_msgs/TFMessage: {error!r}; "
            'base = "" in [bag] leaves them alone'
        ) from error
    mounts = {n: frames[r.frame] for n, r in gathered.items() if r.frame in frames}
    notes = list(bag.notes)
    tables = {name: _table(path, name, gathered[name], notes) for name in config.topics}
    truth = tables.pop(config.truth) if config.truth is not None else None
    maps = {name: _map(path, gathered[f"map {name}"]) for name in config.maps}
    files = (
        (path,) if path.is_file() else tuple(sorted(p for p in path.iterdir() if p.is_file()))
    )
    return RawLog(path.stem, tables, truth, maps, files, tuple(notes), "Unix", mounts=mounts)


def _decoded(message: Message, place: str) -> Any:
    try:
        return message.decode()
    except Exception as error:
        # Whatever a decoder raises, to the user it is one thing: the type is not known.
        raise DataError(
            f"{place}: cannot be decoded with the definition in the bag: "
            f"{type(error).__name__}: {error}"
        ) from error


def _check_topics(path: Path, bag: Bag, wanted: dict[str, TopicConfig]) -> None:
    for name, spec in wanted.items():
        if spec.topic not in bag.topics:
            known = ", ".join(f"{t} ({kind})" for t, kind in sorted(bag.topics.items()))
            raise DataError(
                f"{path}: no topic {spec.topic!r} (for {name}); there are {known or 'none'}"
            )


def _table(path: Path, name: str, rows: Rows, notes: list[str]) -> Table:
    if not rows.stamps:
        raise DataError(f"{path}: topic {rows.spec.topic!r}: found no rows, expected some")
    texts = {"target": rows.targets} if rows.spec.target is not None else {}
    table = table_of(
        name, path, np.array(rows.stamps), rows.columns(), texts, np.array(rows.lines)
    )
    return in_order(table, notes, MOST_DISORDER)


def _map(path: Path, rows: Rows) -> TargetMap:
    """Targets from the first message of a topic."""
    columns = {
        name: values * unit_of(unit)[1] for name, (values, unit) in rows.columns().items()
    }
    units = {name: unit_of(unit)[0] for name, unit in rows.units.items()}
    return checked_map(f"{path}: topic {rows.spec.topic!r}", rows.targets, columns, units)


def _find(content: Any, way: str, place: str) -> Any:
    """Follow a way of names and [indices] into a message."""
    value = content
    for name, index in STEP.findall(way):
        try:
            if index:
                value = value[int(index)]
            else:
                value = value[name] if isinstance(value, dict) else getattr(value, name)
        except (AttributeError, KeyError, IndexError, TypeError):
            step = f"[{index}]" if index else repr(name)
            raise DataError(
                f"{place}: no {step} on the way {way!r}; there are "
                f"{', '.join(_names(value)) or 'no fields'}"
            ) from None
    return value


def _names(content: Any) -> list[str]:
    if isinstance(content, dict):
        return sorted(map(str, content))
    if hasattr(content, "DESCRIPTOR"):
        return [field.name for field in content.DESCRIPTOR.fields]
    if isinstance(content, list | tuple | np.ndarray):
        return [f"[0] to [{len(content) - 1}]"]
    fields = getattr(content, "__dataclass_fields__", {})
    return [name for name in fields if not name.startswith("__")]


def _numbers(name: str, content: Any, column: FieldConfig, place: str) -> tuple[float, ...]:
    """What a column gets of a message: a number, or what it makes of a quaternion."""
    around, _, axis = column.field.rpartition(".")
    angle = column.unit in ANGLES and around and axis in set("wxyz")
    if angle and quaternion_in(_find(content, around, place)):
        raise DataError(
            f"{place}: {column.field!r} is a component of a quaternion, not an angle in "
            f"{column.unit}; field = {around!r} takes the heading of it"
        )
    turn = quaternion_in(_find(content, column.field, place))
    if turn is not None:
        return turn_of(name, column.unit, turn, f"{place}: {column.field!r}")
    if name == ATTITUDE:
        raise DataError(f"{place}: {column.field!r}: found no quaternion, expected one")
    return (_number(content, column.field, place),)


def _number(content: Any, way: str, place: str) -> float:
    value = _find(content, way, place)
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        kind = type(value).__name__
        raise DataError(f"{place}: {way!r}: found a {kind}, expected a number") from None


def _stamp(content: Any, spec: TopicConfig, place: str) -> int:
    """A stamp in ns: of ROS, of Protobuf, of Foxglove's JSON, or a plain number."""
    value = _find(content, spec.stamp, place)
    if isinstance(value, int | float | str | np.number):
        try:
            return TimeForm(spec.stamp_unit).parse(str(value))
        except (ValueError, ArithmeticError):
            raise DataError(
                f"{place}: {spec.stamp!r}: found {value!r}, expected a time"
            ) from None
    for whole, fraction in (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos")):
        parts = [_or_none(value, name) for name in (whole, fraction)]
        if None not in parts:
            with contextlib.suppress(TypeError, ValueError, OverflowError):
                return int(parts[0]) * 10**9 + int(parts[1])
            raise DataError(
                f"{place}: {spec.stamp!r}: found {parts}, expected two whole numbers"
            )
    raise DataError(
        f"{place}: {spec.stamp!r}: found {', '.join(_names(value))}, expected a time; "
        'stamp = "bag" takes the time of recording'
    )


def _or_none(content: Any, name: str) -> Any:
    return content.get(name) if isinstance(content, dict) else getattr(content, name, None)
