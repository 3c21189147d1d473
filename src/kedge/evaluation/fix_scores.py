"""What fixes are worth, each epoch of ranges by itself."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from kedge.evaluation.consistency import nees
from kedge.evaluation.scores import Provenance
from kedge.positioning.fix import Fix, Status


@dataclass(frozen=True)
class FixScores:
    """One solver over a log. Errors need truth."""

    epochs: int
    fixes: int
    """Epochs with a position, be it ambiguous."""
    fix: int
    """Epochs with one position, which the ranges single out."""
    ambiguous: int
    """Epochs with a second position that the ranges do not rule out."""
    too_few: int
    """Epochs with fewer usable ranges than unknowns."""
    no_fix: int
    """Epochs whose numbers led nowhere."""
    redundancy: float
    """Mean number of ranges beyond what a fix needs."""
    pdop: float
    """Median dilution of precision."""
    crlb: float
    """Median of the least standard deviation that an unbiased solver can have, in m."""
    rmse: Mapping[str, float] = field(default_factory=dict)
    """In m."""
    median: float | None = None
    """Error, in m."""
    p95: float | None = None
    """The error that 95 % of the fixes stay below, in m."""
    bias: tuple[float, ...] = ()
    """Mean error by axis, in m."""
    nees: float | None = None
    """Mean squared error in units of the fix's own covariance."""
    nees_dof: int | None = None
    """What it is on average if the covariance is right."""


@dataclass(frozen=True)
class LocateSummary:
    """``summary.json`` of ``kedge locate``."""

    about: Provenance = field(metadata={"inline": True})
    anchors: tuple[str, ...]
    epochs: int
    window: float
    """Seconds that an epoch of ranges lasts."""
    filters: Mapping[str, FixScores]
    """By solver."""


def score_fixes(
    fixes: Fix, truth: Float[np.ndarray, "n d"] | None, known: Bool[np.ndarray, " n"] | None
) -> FixScores:
    """How many of each status there are and, where truth is known, how large the errors are."""
    status = np.asarray(fixes.status)
    valid = status <= Status.AMBIGUOUS
    scores = FixScores(
        epochs=len(status),
        fixes=int(valid.sum()),
        fix=int((status == Status.FIX).sum()),
        ambiguous=int((status == Status.AMBIGUOUS).sum()),
        too_few=int((status == Status.TOO_FEW).sum()),
        no_fix=int((status == Status.NO_FIX).sum()),
        redundancy=float(np.asarray(fixes.redundancy)[valid].mean()) if valid.any() else 0.0,
        pdop=_median(np.asarray(fixes.pdop)[valid]),
        crlb=_median(np.asarray(fixes.crlb)[valid]),
    )
    if truth is None or known is None or not (judged := valid & known).any():
        return scores
    error = np.asarray(fixes.position)[judged] - truth[judged]
    far = np.linalg.norm(error, axis=1)
    return replace(
        scores,
        rmse={"position": float(np.sqrt(np.mean(far**2)))},
        median=float(np.median(far)),
        p95=float(np.quantile(far, 0.95)),
        bias=tuple(np.mean(error, axis=0).tolist()),
        nees=float(np.mean(nees(error, np.asarray(fixes.cov)[judged]))),
        nees_dof=error.shape[1],
    )


def _median(values: np.ndarray) -> float:
    kept = values[np.isfinite(values)]
    return float(np.median(kept)) if len(kept) else float("nan")
