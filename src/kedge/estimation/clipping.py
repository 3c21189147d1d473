"""Controls that are told beyond what the vehicle can do: they act as what it can."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kedge.core.contracts import AbstractVehicle
from kedge.core.manifolds import space_of
from kedge.estimation.log import Recording

ROUNDING = 1e-3
"""By this share a control may lie beyond its limit: it is written in other units, rounded."""


def clipped(recording: Recording, vehicle: AbstractVehicle) -> dict[str, Any]:
    """By component of the control that was ever beyond its limit: limit, commands, seconds.

    ``commands`` counts how often it was told anew and lay beyond, ``seconds`` is for how long
    it was held there, ``largest`` how far it went.
    """
    limits, log = vehicle.control_limits(), recording.log
    if limits is None:
        return {}
    time = np.asarray(log.schedule.time)
    spans, count, shares = np.diff(time, prepend=0.0), len(time), {}
    size = np.concatenate([np.abs(np.reshape(v, (count, -1))) for v in log.controls], axis=1)
    ends = _ends(limits, [np.shape(value)[1:] for value in log.controls])
    # A control is held until it is told anew; telling the same again is no other command.
    anew = np.concatenate([np.ones((1, len(ends)), bool), np.diff(size, axis=0) != 0])
    for place, label in enumerate(space_of(type(log.controls)).labels):
        beyond = size[:, place] > ends[place] * (1 + ROUNDING)
        if beyond.any():
            shares[label] = {
                "limit": float(ends[place]),
                "commands": int((beyond & anew[:, place]).sum()),
                "seconds": float(spans[beyond].sum()),
                "largest": float(size[:, place].max()),
            }
    return shares


def beyond(control: Any, limits: Any) -> list[str]:
    """The components of one control that are beyond their limits."""
    size = np.concatenate([np.abs(np.ravel(value)) for value in control])
    ends = _ends(limits, [np.shape(value) for value in control])
    labels, far = space_of(type(control)).labels, size > ends * (1 + ROUNDING)
    return [label for label, is_far in zip(labels, far, strict=True) if is_far]


def sentences(shares: dict[str, Any]) -> list[str]:
    """What a user should know of it."""
    return [
        f"control: {label} was told {entry['commands']} times to be beyond its limit of "
        f"{entry['limit']:.3g} (up to {entry['largest']:.3g}), for {entry['seconds']:.1f} s in "
        "all; it acts as the limit"
        for label, entry in shares.items()
    ]


def _ends(limits: Any, shapes: Sequence[tuple[int, ...]]) -> np.ndarray:
    """The limit of each component; a field may have one for all of its own."""
    each = zip(limits, shapes, strict=True)
    return np.concatenate([np.ravel(np.broadcast_to(end, shape)) for end, shape in each])
