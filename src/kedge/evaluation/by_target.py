"""Residuals by target: which landmark, beacon or anchor is not what the map says of it."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from kedge.core.verdicts import Verdict
from kedge.estimation.step import Outcome
from kedge.evaluation.scores import FilterScores, ResidualScore, TargetScores

FEW = 20  # readings; a median of fewer says little
OFF = 0.7  # predicted standard deviations of the median from 0; honest ones stay below a tenth
MOST = 100  # targets of a sensor that are told apart


class Off(NamedTuple):
    """A target whose residuals are not about zero."""

    sensor: str
    target: str
    component: str
    unit: str
    median: float
    standardised: float


def target_scores(
    outcome: Outcome,
    mine: Int[np.ndarray, " n"],
    target: Int[np.ndarray, " n"],
    ids: tuple[str, ...],
    labels: tuple[str, ...],
) -> dict[str, TargetScores]:
    """By target and component: median and spread of the residuals, those of a gate included.

    ``standardised`` is the median of the residuals in predicted standard deviations: a bias
    of the target, a wrong place on the map. Medians, since outliers are another matter.

    Args:
        outcome: of all events.
        mine: the events of one sensor.
        target: the target of each of these.
        ids: the targets' names.
        labels: of the components of its measurement.
    """
    scores = {}
    for index, name in enumerate(ids[:MOST]):
        rows = mine[target == index]
        if not len(rows):
            continue
        verdicts = np.asarray(outcome.verdict)[rows]
        judged = (verdicts == Verdict.FUSED) | (verdicts == Verdict.GATED)
        residuals = {}
        residual = np.asarray(outcome.residual)[rows][judged][:, : len(labels)]
        std = np.asarray(outcome.std)[rows][judged][:, : len(labels)]
        for at, label in enumerate(labels):
            measured = np.isfinite(residual[:, at])
            if measured.any():
                residuals[label] = _spread(residual[measured, at], std[measured, at])
        gated = int((verdicts == Verdict.GATED).sum())
        scores[name] = TargetScores(len(rows), gated, residuals)
    return scores


def _spread(residual: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]) -> ResidualScore:
    median = float(np.median(residual))
    return ResidualScore(
        median,
        spread=float(1.4826 * np.median(np.abs(residual - median))),
        standardised=float(np.median(residual / std)),
    )


def targets_off(scores: FilterScores, units: Mapping[str, Mapping[str, str]]) -> list[Off]:
    """Targets whose readings are off on the whole, the worst first.

    Args:
        scores: of a run.
        units: by sensor, the unit of each component.
    """
    biased = [
        Off(sensor, target, label, unit, residual.median, residual.standardised)
        for sensor, entry in scores.sensors.items()
        for target, about in entry.targets.items()
        if about.readings >= FEW
        for label, unit in units.get(sensor, {}).items()
        if (residual := about.residuals.get(label)) is not None
        and abs(residual.standardised) > OFF
    ]
    return sorted(biased, key=lambda off: -abs(off.standardised))
