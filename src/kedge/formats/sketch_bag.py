"""The topics of a bag as a rig file may declare them: what each field seems to be."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kedge.core.errors import DataError
from kedge.formats.bag_messages import Message, open_bag
from kedge.formats.bag_turns import quaternion_in
from kedge.formats.guesses import TARGET, Guess, compassed, guess, plain
from kedge.formats.sketch_folder import TRUTH
from kedge.formats.toml import quoted

SKIPPED = {"header", "stamp", "seq", "covariance", "child_frame_id"}
TRIANGLE = {"xx": 0, "xy": 1, "xh": 5, "yy": 7, "yh": 11, "hh": 35}
"""Where a planar pose's covariance stands in the 36 numbers of ROS."""


class SketchedTopic(NamedTuple):
    """One topic, as it seems to be."""

    name: str
    topic: str
    kind: str
    rate: float
    stamped: bool
    each: str | None
    target: str | None
    columns: dict[str, tuple[str, Guess]]
    """By name inside: the way to it."""

    @property
    def is_map(self) -> bool:
        """Whether it tells where targets are, and nothing of the vehicle."""
        places = all(name.startswith("position_") for name in self.columns)
        return self.target is not None and places and bool(self.columns)


def sketch_bag(path: Path) -> tuple[dict[str, SketchedTopic], dict[str, str]]:
    """Guess at every topic by its first message; and the topics that nothing is made of.

    Raises:
        DataError: the bag cannot be read, or no topic has numbers that mean something.
    """
    first: dict[str, Message] = {}
    counts: dict[str, list[int]] = {}
    with open_bag(path) as bag:
        for message in bag.messages(set(bag.topics)):
            first.setdefault(message.topic, message)
            counts.setdefault(message.topic, []).append(message.time)
        topics, others = {}, dict(bag.topics)
        for topic, message in first.items():
            try:
                sketched = _sketched(message, message.decode(), np.array(counts[topic]))
            except Exception as error:  # a type that nobody can decode is one topic less
                others[topic] = f"{message.type}: {error}"
                continue
            if sketched.columns:
                topics[sketched.name] = sketched
                others.pop(topic, None)
    if not topics:
        raise DataError(
            f"{path}: found no topic with positions, speeds, ranges or the like; there are "
            f"{', '.join(f'{t} ({kind})' for t, kind in others.items()) or 'none'}"
        )
    return topics, others


def truth_of(topics: dict[str, SketchedTopic]) -> str | None:
    """The topic whose name says that it is the truth."""
    wanted = ("vive", "optitrack")
    return next(
        (
            name
            for name, topic in topics.items()
            if "position_x" in topic.columns
            and not topic.is_map
            and (TRUTH[0].search(name) or any(word in name for word in wanted))
        ),
        None,
    )


def _sketched(message: Message, content: Any, times: np.ndarray) -> SketchedTopic:
    each = next((way for way, value in _leaves(content) if _is_table(value)), None)
    element = content if each is None else _at(content, each)[0]
    columns: dict[str, tuple[str, Guess]] = {}
    target = None
    for way, value in _leaves(element):
        last = plain(way.rpartition(".")[2])
        if each is not None and TARGET.match(last):
            target = way
        elif quaternion_in(value):
            columns.setdefault("attitude", (way, Guess("attitude", "1", "a quaternion")))
        elif isinstance(value, int | float | np.number) and not isinstance(value, bool):
            guessed = guess(way.replace(".", "_"), None)
            if guessed and not guessed.name.endswith("_down"):  # messages have no frame "ned"
                guessed = compassed({way: guessed})[0][way]
            if guessed and len(way) < len(columns.get(guessed.name, (way + "+",))[0]):
                columns[guessed.name] = way, guessed
    if target and "range" in columns:  # where the target is, if anything
        columns = {n: c for n, c in columns.items() if not n.startswith("position_")}
    if TRUTH[0].search(plain(message.topic)) and "position_x" in columns:
        columns = {n: c for n, c in columns.items() if "twist" not in c[0]}
    elif "speed" in columns and "position_x" in columns:
        # The pose of an odometry is its twist, integrated.
        columns = {n: c for n, c in columns.items() if "twist" in c[0]}
        turn = columns.pop("angular_rate_z", None)
        if turn:
            columns = {"speed": columns["speed"], "yaw_rate": (turn[0], turn[1])}
    elif len(_at(content, "pose.covariance")) == 36 and np.any(_at(content, "pose.covariance")):
        for name, at in TRIANGLE.items():
            unit = {0: "m^2", 1: "m*rad", 2: "rad^2"}[name.count("h")]
            way = f"pose.covariance[{at}]"
            columns[name] = way, Guess(name, unit, "the covariance that comes with it")
    span = max(float(times[-1] - times[0]) / 1e9, 1e-9)
    stamped = any(_at(content, f"header.stamp.{part}") != () for part in ("sec", "seconds"))
    return SketchedTopic(
        plain(message.topic),
        message.topic,
        message.type,
        (len(times) - 1) / span,
        stamped,
        each,
        target,
        columns,
    )


def _fields(content: Any) -> dict[str, Any]:
    if isinstance(content, dict):
        return content
    if hasattr(content, "DESCRIPTOR"):
        return {f.name: getattr(content, f.name) for f in content.DESCRIPTOR.fields}
    names = getattr(content, "__dataclass_fields__", {})
    return {name: getattr(content, name) for name in names if not name.startswith("__")}


def _leaves(content: Any, way: str = "") -> Iterator[tuple[str, Any]]:
    """What a message has that is no message itself, and its quaternions."""
    for name, value in _fields(content).items():
        if name in SKIPPED:
            continue
        inside = f"{way}.{name}" if way else name
        if _fields(value) and not quaternion_in(value):
            yield from _leaves(value, inside)
        else:
            yield inside, value


def _is_table(value: Any) -> bool:
    """Whether it is a list of messages."""
    listed = isinstance(value, list | tuple) or hasattr(value, "add")
    return listed and len(value) > 0 and bool(_fields(value[0]))


def _at(content: Any, way: str) -> Any:
    """What stands at a way, or nothing."""
    for name in way.split("."):
        fields = _fields(content)
        if name not in fields:
            return ()
        content = fields[name]
    return content


def bag_text(topics: dict[str, SketchedTopic], others: dict[str, str], planar: bool) -> str:
    """The sketch as the part of a rig file that is about the bag."""
    truth = truth_of(topics)
    lines = ['format = "bag"', ""]
    lines += ["[bag]", f"truth = {quoted(truth)}  # by its name"] if truth else []
    for topic in topics.values():
        key = f"{'maps' if topic.is_map else 'topics'}.{topic.name}"
        lines += ["", f"[bag.{key}]  # {topic.kind}, {topic.rate:.3g} Hz"]
        lines += [f"topic = {quoted(topic.topic)}"]
        if not topic.stamped and not topic.is_map:
            lines += ['stamp = "bag"  # it has no header: the time of recording']
        lines += [f"each = {quoted(topic.each)}"] if topic.each else []
        lines += [f"target = {quoted(topic.target)}"] if topic.target else []
        lines += ["", f"[bag.{key}.columns]"]
        for name, (way, guessed) in topic.columns.items():
            unit = guessed.unit
            if name == "attitude" and planar:
                name, unit = "heading", "rad"
            lines.append(
                f"{name} = {{ field = {quoted(way)}, unit = {quoted(unit)} }}  # {guessed.why}"
            )
    lines += [f"# not used: {topic} ({kind})" for topic, kind in others.items()]
    return "\n".join(lines) + "\n"
