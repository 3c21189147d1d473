"""Where sensors sit on the body, by the frames of ``/tf_static``."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

TOPIC = "/tf_static"


class Placed(NamedTuple):
    """A frame on the body: m forward, left, up; turned as mounts are (rad)."""

    frame: str
    x: float
    y: float
    z: float
    heading: float
    pitch: float
    roll: float


class _Link(NamedTuple):
    parent: str
    turn: Rotation
    arm: Float[np.ndarray, "3"]


def frames_of(messages: Iterable[Any], base: str) -> dict[str, Placed]:
    """The frames that hang on ``base``, by name, from decoded messages of ``/tf_static``."""
    links: dict[str, _Link] = {}
    for message in messages:
        for child, link in _links(message):
            links[child] = link
    mounts = {}
    for name in links:
        placed = _from(base, name, links)
        if placed is not None:
            mounts[name] = placed
    return mounts


def _links(message: Any) -> Iterator[tuple[str, _Link]]:
    for entry in _part(message, "transforms"):
        move = _part(entry, "transform")
        turn, arm = (_part(move, name) for name in ("rotation", "translation"))
        quaternion = np.array([float(_part(turn, axis)) for axis in "xyzw"])
        if not np.linalg.norm(quaternion) > 0:
            continue
        yield (
            plain_frame(_part(entry, "child_frame_id")),
            _Link(
                plain_frame(_part(_part(entry, "header"), "frame_id")),
                Rotation.from_quat(quaternion),
                np.array([float(_part(arm, axis)) for axis in "xyz"]),
            ),
        )


def _from(base: str, name: str, links: Mapping[str, _Link]) -> Placed | None:
    """A frame as seen from ``base``; None if no way leads there."""
    turn, arm, at = Rotation.identity(), np.zeros(3), name
    for _ in links:
        if at == base:
            break
        if at not in links:
            return None
        link = links[at]
        turn, arm, at = link.turn * turn, link.turn.apply(arm) + link.arm, link.parent
    if at != base:
        return None
    x, y, z = arm.tolist()
    heading, pitch, roll = turn.as_euler("ZYX").tolist()
    return Placed(name, x, y, z, heading, pitch, roll)


def plain_frame(name: Any) -> str:
    """A frame's name as ROS 2 has it: without the slash before it."""
    return str(name).lstrip("/")


def frame_in(content: Any) -> str:
    """The frame that a message is in; "" if it says none."""
    try:
        return plain_frame(_part(_part(content, "header"), "frame_id"))
    except (AttributeError, KeyError):
        return ""


def _part(content: Any, name: str) -> Any:
    return content[name] if isinstance(content, dict) else getattr(content, name)
