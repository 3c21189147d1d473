"""Sensors not heard for longer than their rig allows: the estimate is degraded then."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig
from kedge.evaluation.scores import Silence


def silences(estimates: Estimates, recording: Recording, rig: Rig) -> dict[str, Silence]:
    """By sensor with an ``allowed_silence``: when it was exceeded (from, to; s), and how long.

    A reading counts if it was fused: one that is missing, refused or not finite is none. The
    estimate is degraded from the moment at which more than what is allowed has passed.
    """
    sensor = np.asarray(recording.log.schedule.sensor)
    time = np.asarray(recording.log.schedule.time)
    fused = np.asarray(estimates.outcome.verdict) == Verdict.FUSED
    by_sensor = {}
    for number, installation in enumerate(rig.sensors):
        if (allowed := installation.allowed_silence) is not None:
            heard = time[(sensor == number) & fused]
            stretches = exceeded(heard, float(time[-1]), allowed)
            seconds = sum(end - begin for begin, end in stretches)
            by_sensor[installation.name] = Silence(allowed, tuple(stretches), seconds)
    return by_sensor


def exceeded(
    heard: Float[np.ndarray, " n"], end: float, allowed: float
) -> list[tuple[float, float]]:
    """From when to when nothing had been heard for longer than ``allowed``; all in s.

    What is heard is looked for from time 0 to ``end``.
    """
    marks = np.concatenate([[0.0], heard, [end]])
    long = np.flatnonzero(np.diff(marks) > allowed)
    return [(float(marks[i] + allowed), float(marks[i + 1])) for i in long]


def sentences(name: str, silent: Mapping[str, Silence]) -> list[str]:
    """What a user should know of it."""
    return [
        f"{name}: {sensor} was not heard for {end - begin + silence.allowed:.1f} s "
        f"until {end:.1f} s, allowed are {silence.allowed:g} s: the estimate is "
        f"degraded from {begin:.1f} s on until then."
        for sensor, silence in silent.items()
        for begin, end in silence.stretches
    ]
