"""Odometry as a log tells it, as increments from row to row: counts of ticks, and poses."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

Columns = Mapping[str, Float[np.ndarray, " n"]]
POSE = {"position_x": "m", "position_y": "m", "heading": "rad"}
TWIST = {"forward", "speed", "sideways", "yaw_rate"}
"""What a vehicle may be driven by if its odometry tells poses."""


def counted(counts: Columns, counter: float | None) -> dict[str, Float[np.ndarray, " n"]]:
    """Ticks since the row before; a counter of ``counter`` values starts anew after its last.

    Between two rows it must not run through half of its range.
    """
    increments = {}
    for name, values in counts.items():
        change = np.diff(values, prepend=values[:1])
        if counter is not None:
            change = (change + counter / 2) % counter - counter / 2
        increments[name] = change
    return increments


def driven(poses: Columns) -> dict[str, Float[np.ndarray, " n"]]:
    r"""Ways forward and to the left (m) and turns (rad) since the row before, at even speed.

    What :func:`kedge.vehicles.arc.along_arc` makes a pose into the next:
    $d = \mathrm{Rot}(-\psi - \theta/2)\, (p' - p) / \operatorname{sinc}(\theta/2)$.
    """
    heading = np.asarray(poses["heading"])
    turn = np.diff(heading, prepend=heading[:1])
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    middle = np.append(heading[:1], heading[:-1]) + turn / 2
    x, y = (np.diff(poses[name], prepend=poses[name][:1]) for name in list(POSE)[:2])
    chord = np.sinc(turn / (2 * np.pi))
    forward = (np.cos(middle) * x + np.sin(middle) * y) / chord
    sideways = (np.cos(middle) * y - np.sin(middle) * x) / chord
    return {"forward": forward, "speed": forward, "sideways": sideways, "yaw_rate": turn}
