"""Residuals by target: which landmark, beacon or anchor is not what the map says of it."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from kedge.core.verdicts import Verdict
from kedge.estimation.step import Outcome

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
) -> dict[str, Any]:
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
    found = {}
    for index, name in enumerate(ids[:MOST]):
        rows = mine[target == index]
        if not len(rows):
            continue
        verdicts = np.asarray(outcome.verdict)[rows]
        judged = (verdicts == Verdict.FUSED) | (verdicts == Verdict.GATED)
        entry: dict[str, Any] = {
            "readings": len(rows),
            "gated": int((verdicts == Verdict.GATED).sum()),
        }
        residual = np.asarray(outcome.residual)[rows][judged][:, : len(labels)]
        std = np.asarray(outcome.std)[rows][judged][:, : len(labels)]
        for at, label in enumerate(labels):
            there = np.isfinite(residual[:, at])
            if there.any():
                entry[label] = _spread(residual[there, at], std[there, at])
        found[name] = entry
    return found


def _spread(
    residual: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]
) -> dict[str, float]:
    median = float(np.median(residual))
    return {
        "median": median,
        "spread": float(1.4826 * np.median(np.abs(residual - median))),
        "standardised": float(np.median(residual / std)),
    }


def targets_off(scores: Mapping[str, Any], units: Mapping[str, Mapping[str, str]]) -> list[Off]:
    """Targets whose readings are off on the whole, the worst first.

    Args:
        scores: of a run.
        units: by sensor, the unit of each component.
    """
    found = []
    for sensor, entry in scores["sensors"].items():
        for target, about in entry.get("targets", {}).items():
            if about["readings"] < FEW:
                continue
            for label, unit in units.get(sensor, {}).items():
                part = about.get(label)
                if part is not None and abs(part["standardised"]) > OFF:
                    found.append(
                        Off(sensor, target, label, unit, part["median"], part["standardised"])
                    )
    return sorted(found, key=lambda off: -abs(off.standardised))
