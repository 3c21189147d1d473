"""Sensors whose readings were outliers for long, and when one was let in for that."""

from collections.abc import Mapping

import numpy as np

from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig
from kedge.evaluation.scores import Refusals
from kedge.filters.wrappers.wrapper import RECOVERY


def refusals(estimates: Estimates, recording: Recording, rig: Rig) -> dict[str, Refusals]:
    """By sensor that had nothing but outliers for :data:`RECOVERY` or longer, or recovered.

    ``stretches`` are those times (from, to; s; from the first outlier to the last),
    ``longest`` is the longest of them in s, ``recovered`` when a reading was let in (s). An
    outlier was refused by a gate or weighed down by a robust loss.
    """
    outcome = estimates.outcome
    sensor, time = (np.asarray(x) for x in recording.log.schedule[1::-1])
    verdict, outlying, recovered = (
        np.asarray(x) for x in (outcome.verdict, outcome.outlying, outcome.recovered)
    )
    by_sensor = {}
    for number, name in enumerate(rig.names):
        judged = (sensor == number) & ((verdict == Verdict.FUSED) | (verdict == Verdict.GATED))
        times, bad = time[judged], outlying[judged]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
        pairs = zip(times[edges[::2]], times[edges[1::2] - 1], strict=True)
        stretches = [(float(a), float(b)) for a, b in pairs if b - a >= RECOVERY]
        let_in = [float(t) for t in time[(sensor == number) & recovered]]
        if stretches or let_in:
            longest = max((b - a for a, b in stretches), default=0.0)
            by_sensor[name] = Refusals(tuple(stretches), longest, tuple(let_in))
    return by_sensor


def sentences(name: str, by_sensor: Mapping[str, Refusals]) -> list[str]:
    """What a user should know of it."""
    warnings = []
    for sensor, entry in by_sensor.items():
        times = [f"{t:.1f} s" for t in entry.recovered]
        acted = "none was let in"
        if times:
            more = f" and {len(times) - 3} times more" if len(times) > 3 else ""
            acted = f"one was let in at {', '.join(times[:3])}{more}"
        if entry.stretches:
            begin, end = max(entry.stretches, key=lambda s: s[1] - s[0])
            warnings.append(
                f"{name}: all readings of {sensor} were outliers for {end - begin:.1f} s, from "
                f"{begin:.1f} s on (the longest of {len(entry.stretches)}); {acted}."
            )
        else:
            warnings.append(f"{name}: after nothing but outliers of {sensor} {acted}.")
    return warnings
