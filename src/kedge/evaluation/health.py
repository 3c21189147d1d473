"""Numerical health of a run: what a filter had to do to keep its belief usable."""

from collections.abc import Mapping
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates
from kedge.evaluation import refusals, silences
from kedge.evaluation.scores import EffectiveSize, HealthScores

LARGE = 100  # components; above it the eigenvalues of every event take too long


def health(estimates: Estimates) -> HealthScores:
    """Counts of repairs and recoveries, the least certain direction, what particles did.

    ``smallest_eigenvalue`` is the least, over all events, of the correlation matrix's: it has
    no unit, 1 is independent, 0 is a direction that is known exactly, and below 0 the matrix
    is no covariance. Effective sizes are those before resampling; ``depleted`` counts the
    readings that no particle explained, ``collapsed`` those that fewer than two did. What a
    filter has not is left out.
    """
    outcome = jax.tree.map(np.asarray, estimates.outcome)
    cov = np.asarray(estimates.moments.cov)
    scores = HealthScores(
        repairs=int(outcome.repairs.sum()),
        recoveries=int(outcome.recovered.sum()),
        smallest_eigenvalue=smallest_eigenvalue(cov) if cov.shape[-1] <= LARGE else None,
    )
    sizes = outcome.effective_size[np.isfinite(outcome.effective_size)]
    if not len(sizes):
        return scores
    return replace(
        scores,
        effective_size=EffectiveSize(float(sizes.min()), float(np.median(sizes))),
        resampled=int(outcome.resampled.sum()),
        depleted=int((sizes == 0).sum()),
        collapsed=int(((sizes > 0) & (sizes < 2)).sum()),
    )


def smallest_eigenvalue(cov: Float[np.ndarray, "T n n"]) -> float:
    """The least of all correlation matrices; a component without variance stands alone."""
    std = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.where(std > 0, std, 1.0)
    correlation = cov / (scale[:, :, None] * scale[:, None, :])
    alone = std == 0
    i = np.arange(cov.shape[-1])
    correlation[:, i, i] += alone
    return float(np.linalg.eigvalsh(correlation).min())


def concerns(name: str, scores: HealthScores, verdicts: Mapping[str, int]) -> list[str]:
    """What of it a user should know, in sentences; none if all is well.

    ``verdicts`` counts those of all readings.
    """
    warnings = []
    if scores.repairs and scores.effective_size is not None:
        warnings.append(
            f"{name}: at {scores.repairs} readings the particles were resampled into so few "
            "places that their covariance was singular; they were widened. More particles, or "
            "more noise, would have kept them apart."
        )
    elif scores.repairs:
        warnings.append(
            f"{name}: a covariance had to be repaired {scores.repairs} times; it was not "
            "positive semi-definite. A square-root filter cannot lose it."
        )
    if (scores.smallest_eigenvalue or 0.0) < -1e-9:
        warnings.append(
            f"{name}: a covariance is not positive semi-definite; the least eigenvalue of its "
            f"correlations is {scores.smallest_eigenvalue:.1e}."
        )
    if scores.depleted:
        judged = sum(verdicts.get(v.name, 0) for v in (Verdict.FUSED, Verdict.DROPPED))
        warnings.append(
            f"{name}: no particle explained {scores.depleted} of {judged} readings, which "
            "were left out; more particles, or a wider start or noise, would."
        )
    if scores.collapsed:
        warnings.append(
            f"{name}: at {scores.collapsed} readings one particle carried nearly all the "
            "weight; there the estimate is that of luck."
        )
    warnings += refusals.sentences(name, scores.refusals)
    return warnings + silences.sentences(name, scores.silences)
