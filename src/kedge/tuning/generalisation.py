"""Whether what is tuned on some logs holds on another: one is left out at a time."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.tuning.evaluator import Case
from kedge.tuning.tunable import Tunable
from kedge.tuning.tuning import Fit, Search, fit

COSTLY = 0.1
"""Nats by judgement: what a deviation a third too small costs a reading of one component."""
FARTHER = 1.1
"""By this factor an error must grow to count."""
TOO_SURE = 1.6
"""NEES by its expectation, above which a filter is more certain than it may be."""


class LeftOut(NamedTuple):
    """A log, or a block of one, that the others were tuned without."""

    values: Float[np.ndarray, " p"]
    """Found on the others."""
    judged: int
    start: float
    """Its own loss by judgement with the rig's values,"""
    tuned_on: float
    """with those found on all, itself included,"""
    left_out: float
    """and with those found on the others."""


class Generalisation(NamedTuple):
    """What tuning is worth where it was not tuned."""

    status: str
    """``holds``, ``farther off``, ``too sure``, ``over-fit`` or ``worse``."""
    sentence: str
    start: float
    tuned_on: float
    left_out: float
    """Losses by judgement, over all that was left out in turn."""


def leave_one_out(
    filter: AbstractFilter,
    without: Sequence[Sequence[Case]],
    whole: Fit,
    values: Float[np.ndarray, " p"],
    search: Search,
    horizons: Sequence[float] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> list[LeftOut]:
    """Tune on what remains without each part, from the rig's own values; judge the part.

    A part's loss is that of everything less that of what remains. ``whole`` is the search over
    everything and ``values`` what it found.

    Raises:
        DataError: a part has nothing to judge, or nothing remains without one.
    """
    parts, everything = [], whole.evaluator
    alone = search._replace(starts=1)
    start = np.array([t.value for t in whole.chosen])
    for number, cases in enumerate(without, start=1):
        progress(f"part {number} of {len(without)} left out")
        found = fit(filter, cases, whole.chosen, alone, horizons)
        judged = everything.judged - found.evaluator.judged
        if judged == 0:
            raise DataError(f"tune: part {number} has nothing to judge; leave out larger ones")

        def loss(values: np.ndarray, others: Any = found.evaluator, judged: int = judged):
            totals = [each(each.coordinates(values)).total for each in (everything, others)]
            return (totals[0] - totals[1]) / judged

        parts.append(
            LeftOut(found.values, judged, loss(start), loss(values), loss(found.values))
        )
    return parts


def generalisation(
    parts: Sequence[LeftOut],
    chosen: Sequence[Tunable],
    what: str,
    certainty: float | None = None,
    growth: float | None = None,
) -> Generalisation:
    """The verdict: ``what`` are the parts, such as logs.

    Where truth is known, ``certainty`` is the mean NEES of the parts left out by its
    expectation, and ``growth`` the most that the error of a field is multiplied by: readings
    may be foretold as well elsewhere, and the truth may still be missed.
    """
    weights = np.array([part.judged for part in parts], float)
    losses = np.array([part[2:] for part in parts])
    start, tuned_on, left_out = np.average(losses, axis=0, weights=weights).tolist()
    numbers = f"{len(chosen)} number{'s' * (len(chosen) > 1)}"
    given = f"{numbers} tuned on {int(weights.sum())} judgements of {len(parts)} {what}"
    gap = left_out - tuned_on
    if left_out > start:
        return Generalisation(
            "worse",
            f"does not carry over: {given} are worth less on those left out than the rig's own "
            f"(loss {left_out:.3g} by judgement, {start:.3g} with the rig's); keep the rig's",
            start, tuned_on, left_out,
        )  # fmt: skip
    if gap > COSTLY:
        return Generalisation(
            "over-fit",
            f"over-fit: {given} cost {gap:.2g} by judgement more on those left out than where "
            "they were tuned; tune fewer numbers, or on more",
            start, tuned_on, left_out,
        )  # fmt: skip
    if certainty is not None and not certainty <= TOO_SURE:
        return Generalisation(
            "too sure",
            f"too sure: {given} foretell the readings left out as well, but not the truth: "
            f"NEES is {certainty:.2g} times what it should be; the errors of readings are "
            "correlated or the model lacks something: give the sensor an error with a memory "
            "and use --horizons, or judge --with-truth",
            start, tuned_on, left_out,
        )  # fmt: skip
    if growth is not None and not growth <= FARTHER:
        return Generalisation(
            "farther off",
            f"farther off: {given} foretell the readings left out as well, but the error there "
            f"is {growth:.2g} times what it is with the rig's own values; keep the rig's",
            start, tuned_on, left_out,
        )  # fmt: skip
    return Generalisation(
        "holds",
        f"holds: {given} are worth {start - left_out:.3g} by judgement on those left out, and "
        f"{start - tuned_on:.3g} where they were tuned",
        start, tuned_on, left_out,
    )  # fmt: skip
