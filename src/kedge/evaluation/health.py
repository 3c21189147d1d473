"""Numerical health of a run: what a filter had to do to keep its belief usable."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates
from kedge.evaluation import refusals, silences

LARGE = 100  # components; above it the eigenvalues of every event take too long


def health(estimates: Estimates) -> dict[str, Any]:
    """Counts of repairs and recoveries, the least certain direction, what particles did.

    ``smallest_eigenvalue`` is the least, over all events, of the correlation matrix's: it has
    no unit, 1 is independent, 0 is a direction that is known exactly, and below 0 the matrix
    is no covariance. Effective sizes are those before resampling; ``depleted`` counts the
    readings that no particle explained, ``collapsed`` those that fewer than two did. What a
    filter has not is left out.
    """
    outcome = jax.tree.map(np.asarray, estimates.outcome)
    cov = np.asarray(estimates.moments.cov)
    found: dict[str, Any] = {
        "repairs": int(outcome.repairs.sum()),
        "recoveries": int(outcome.recovered.sum()),
    }
    if cov.shape[-1] <= LARGE:
        found["smallest_eigenvalue"] = smallest_eigenvalue(cov)
    sizes = outcome.effective_size[np.isfinite(outcome.effective_size)]
    if len(sizes):
        found["effective_size"] = {"min": float(sizes.min()), "median": float(np.median(sizes))}
        found["resampled"] = int(outcome.resampled.sum())
        found["depleted"] = int((sizes == 0).sum())
        found["collapsed"] = int(((sizes > 0) & (sizes < 2)).sum())
    return found


def smallest_eigenvalue(cov: Float[np.ndarray, "T n n"]) -> float:
    """The least of all correlation matrices; a component without variance stands alone."""
    std = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.where(std > 0, std, 1.0)
    correlation = cov / (scale[:, :, None] * scale[:, None, :])
    alone = std == 0
    i = np.arange(cov.shape[-1])
    correlation[:, i, i] += alone
    return float(np.linalg.eigvalsh(correlation).min())


def concerns(name: str, found: dict[str, Any], verdicts: Int[np.ndarray, " T"]) -> list[str]:
    """What of it a user should know, in sentences; none if all is well."""
    said = []
    if found["repairs"]:
        said.append(
            f"{name}: a covariance had to be repaired {found['repairs']} times; it was not "
            "positive semi-definite. A square-root filter cannot lose it."
        )
    if found.get("smallest_eigenvalue", 0.0) < -1e-9:
        said.append(
            f"{name}: a covariance is not positive semi-definite; the least eigenvalue of its "
            f"correlations is {found['smallest_eigenvalue']:.1e}."
        )
    if found.get("depleted"):
        judged = int(((verdicts == Verdict.FUSED) | (verdicts == Verdict.DROPPED)).sum())
        said.append(
            f"{name}: no particle explained {found['depleted']} of {judged} readings, which "
            "were left out; more particles, or a wider start or noise, would."
        )
    if found.get("collapsed"):
        said.append(
            f"{name}: at {found['collapsed']} readings one particle carried nearly all the "
            "weight; there the estimate is that of luck."
        )
    said += refusals.sentences(name, found.get("refusals", {}))
    return said + silences.sentences(name, found.get("silences", {}))
