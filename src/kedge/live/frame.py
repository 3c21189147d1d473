"""What the page receives ten times a second, as bytes.

Little endian, every part aligned to 4 bytes: a header of 32 bytes (magic, version, its size,
time, counts of vehicles, columns, readings and targets, sequence number, bytes of the tail),
poses as float32, readings of 48 bytes, states of targets as bytes, JSON without NaN.
"""

import json
import math
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.verdicts import Verdict
from kedge.live.watch import Judged

MAGIC, VERSION, HEADER = 0x3147444B, 1, 32
COLUMNS = (
    "x", "y", "heading", "profile", "major", "minor", "angle", "status", "score",
    "trueX", "trueY", "trueHeading", "sigmaProfile", "flags",
)  # fmt: skip
LOCALIZED, TRUSTED = 1, 2
"""Bits of ``flags``: it knows where it is; no source of positions contradicts it."""
VERDICTS = [verdict.name for verdict in Verdict if verdict >= 0]
_SHOWN = 2
"""Components of a reading that a frame has room for."""


class Frame(NamedTuple):
    """What there is to show of one moment."""

    time: float
    poses: Float[np.ndarray, "vehicles columns"]
    readings: Sequence[tuple[int, Judged]]
    """Numbers of vehicles, and what they read."""
    targets: bytes
    tail: dict[str, Any]


def encode(frame: Frame, sequence: int) -> bytes:
    """The frame as bytes."""
    tail = json.dumps(frame.tail, allow_nan=False, separators=(",", ":")).encode()
    count, columns = frame.poses.shape
    sizes = count, columns, len(frame.readings), len(frame.targets)
    head = struct.pack(
        "<IHHd4HII", MAGIC, VERSION, HEADER, frame.time, *sizes, sequence % 2**32, len(tail)
    )
    poses = np.ascontiguousarray(frame.poses, "<f4").tobytes()
    readings = b"".join(_reading(number, one, frame.time) for number, one in frame.readings)
    padding = bytes(-len(frame.targets) % 4)
    return b"".join((head, poses, readings, frame.targets, padding, tail))


def _reading(vehicle: int, one: Judged, now: float) -> bytes:
    size = min(len(one.value), _SHOWN)
    numbers = np.zeros((3, _SHOWN), "<f4")
    numbers[0, :size] = one.value[:size]
    # The residual is the reading less what was expected.
    numbers[1, :size] = (one.value - one.residual)[:size]
    numbers[2, :size] = one.std[:size]
    numbers[~np.isfinite(numbers)] = 0
    nis = one.nis if math.isfinite(one.nis) else -1.0
    gate = one.threshold if math.isfinite(one.threshold) else -1.0
    head = struct.pack(
        "<HBBhH4f", vehicle, one.sensor, int(one.verdict), one.target, size,
        now - one.received, now - one.stamp, nis, gate,
    )  # fmt: skip
    return head + numbers.tobytes()
