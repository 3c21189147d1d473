"""Glitches of a truth: spans in which a motion capture or a receiver was somewhere else."""

import numpy as np
from jaxtyping import Bool, Float

from kedge.estimation.log import Truth

LONGEST = 2.0
"""s that a glitch lasts at the most; what stays away for longer may be the truth."""
TIMES = 10.0
"""Of the speed that the vehicle has for all but 5 % of its way, for a step to be a jump."""
LEAST = 0.1
"""m of a jump at the least."""


def glitches(
    time: Float[np.ndarray, " K"], position: Float[np.ndarray, "K d"]
) -> Bool[np.ndarray, " K"]:
    """Which samples lie between a jump away and one that leads back.

    A jump is a step of :data:`LEAST` or more at :data:`TIMES` the speed of the vehicle; it
    leads back if what is between can be left out and no jump remains. One that never leads
    back is none to be recognised: nobody knows which side is the truth.
    """
    wrong = np.zeros(len(time), bool)
    if len(time) < 3:
        return wrong
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    moving = steps[steps > 0]
    if not len(moving):
        return wrong
    fastest = TIMES * np.percentile(moving / np.diff(time)[steps > 0], 95)

    def is_jump(before: int, after: int) -> bool:
        way = np.linalg.norm(position[after] - position[before])
        return bool(way >= LEAST and way > fastest * (time[after] - time[before]))

    jumps = [int(n) for n in np.flatnonzero(steps >= LEAST) if is_jump(int(n), int(n) + 1)]
    last = -1
    for number, away in enumerate(jumps):
        if away <= last:
            continue
        for back in jumps[number + 1 :]:
            if time[back + 1] - time[away] > LONGEST:
                break
            if not is_jump(away, back + 1):
                wrong[away + 1 : back + 1] = True
                last = back
                break
    return wrong


def without_glitches(truth: Truth) -> tuple[Truth, int]:
    """The truth without its glitches, and how many samples these were."""
    if "position" not in truth.fields:
        return truth, 0
    wrong = glitches(np.asarray(truth.time), np.asarray(truth.fields["position"]))
    if not wrong.any():
        return truth, 0
    fields = {name: values[~wrong] for name, values in truth.fields.items()}
    return truth._replace(time=truth.time[~wrong], fields=fields), int(wrong.sum())
