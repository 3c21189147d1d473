"""What tuning brought, as numbers and as a figure: parts of a log, profiles of the loss."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from kedge.core.verdicts import Verdict
from kedge.evaluation.consistency import coverage, nees
from kedge.evaluation.score import Run
from kedge.reports import style
from kedge.tuning.tuning import Tuned

if TYPE_CHECKING:
    from matplotlib.figure import Figure
else:
    Figure = Any

COLUMNS = 3


def part_scores(run: Run, begin: float | int, end: float | int) -> dict[str, Any]:
    """Scores of one run after ``begin`` and up to ``end`` seconds; none where nothing is known.

    RMSE, coverage and NEES need truth; NIS and log-likelihood are means by fused reading.
    """
    outcome = run.estimates.outcome
    time = np.asarray(run.estimates.time)
    verdict = np.asarray(outcome.verdict)
    inside = (time > begin) & (time <= end)
    fused = inside & (verdict == Verdict.FUSED)
    found: dict[str, Any] = {
        "readings": int((inside & (verdict != Verdict.NONE)).sum()),
        "fused": int(fused.sum()),
    }
    if fused.any():
        found["nis"] = float(np.asarray(outcome.nis)[fused].mean())
        found["nis_dof"] = float(np.asarray(outcome.dof)[fused].mean())
        found["log_likelihood"] = float(np.asarray(outcome.log_likelihood)[fused].mean())
    if run.errors is None:
        return found
    errors = run.errors
    there = (errors.time > begin) & (errors.time <= end) & ~np.isnan(errors.error).any(axis=1)
    if there.any():
        error = errors.error[there]
        found["rmse"] = {
            field: float(np.sqrt(np.mean(np.sum(error[:, cut] ** 2, axis=1))))
            for field, cut in errors.fields.items()
        }
        found["coverage_95"] = {
            field: float(coverage(error[:, cut], errors.cov[there][:, cut, cut]))
            for field, cut in errors.fields.items()
        }
        found["nees"] = float(np.mean(np.asarray(nees(error, errors.cov[there]))))
        found["nees_dof"] = error.shape[1]
    return found


def parameter_rows(tuned: Tuned) -> list[dict[str, Any]]:
    """One row a number: start, found, factor, standard error, and what the log says of it."""
    return [
        {
            "key": tunable.key,
            "unit": tunable.unit,
            "start": tunable.value,
            "found": float(value),
            "factor": float(value / tunable.value) if tunable.value else None,
            "std_error": judgement.std_error,
            "of_logarithm": tunable.is_logarithmic,
            "interval": list(judgement.interval),
            "identified": judgement.identified,
            "verdict": judgement.verdict,
        }
        for tunable, value, judgement in zip(
            tuned.chosen, tuned.values, tuned.judgements, strict=True
        )
    ]


@style.styled
def draw_profiles(tuned: Tuned) -> Figure | None:
    """How fast the loss rises on either side of each number that is known; None if none is."""
    profiles: Mapping[str, Any] = tuned.profiles
    if not profiles:
        return None
    rows = -(-len(profiles) // COLUMNS)
    axes = style.subplots(rows, COLUMNS, height=0.5 + 2.1 * rows).ravel()
    units = {t.key: t.unit for t in tuned.chosen}
    for ax, (key, (values, rises)) in zip(axes, profiles.items(), strict=False):
        ax.plot(values, rises, color=style.color("filter-1"), marker="o", markersize=2.5)
        ax.axhline(3.84, color=style.color("muted"), lw=0.6, ls=(0, (4, 2)))
        ax.set_title(_shortened(key))
        ax.set_xlabel(units[key].replace("sqrt(Hz)", "√Hz") or "1")
        ax.xaxis.set_major_locator(style.studio("matplotlib.ticker").MaxNLocator(4))
    for ax in axes[::COLUMNS]:
        ax.set_ylabel("2 × rise of the loss")
    for ax in axes[len(profiles) :]:
        ax.remove()
    axes[0].text(0.02, 3.84, "95 %", transform=axes[0].get_yaxis_transform(), va="bottom")
    return axes[0].figure


def _shortened(key: str) -> str:
    return style.words(key.replace("parameters.", "").removeprefix("sensors."))
