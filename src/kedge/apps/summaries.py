"""What the summaries of all commands share: where a result comes from, and their schema."""

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from kedge import __version__
from kedge.apps.console import command_line
from kedge.checking.summary import CheckSummary
from kedge.estimation.compiled import compiler
from kedge.evaluation.fix_scores import LocateSummary
from kedge.evaluation.record import schema
from kedge.evaluation.scores import LogSummary, Provenance
from kedge.formats.results import digest
from kedge.studies.figures_of_merit import StudySummary


def provenance(
    command: str,
    title: str,
    configuration: Mapping[str, Any],
    digests: Mapping[str, str],
    seed: int | None = None,
    runs: int = 1,
    notes: Sequence[str] = (),
    warnings: Sequence[str] = (),
) -> Provenance:
    """Say who computed what; ``digests`` are those of inputs and result."""
    parts = {**digests, "configuration": digest(configuration)}
    return Provenance(
        command=command,
        arguments=tuple(command_line()),
        version=__version__,
        title=title,
        runs=runs,
        notes=tuple(notes),
        warnings=tuple(warnings),
        configuration=configuration,
        digest={**parts, "all": digest(parts)},
        seed=seed,
        versions={n: version(n) for n in ("jax", "equinox", "numpy")} | compiler(),
        platform=f"Python {platform.python_version()}, {platform.machine()}",
    )


def summary_schema() -> dict[str, Any]:
    """The JSON schema of ``summary.json``, whichever command left it."""
    return schema(
        "Summary of a kedge command", LogSummary, LocateSummary, StudySummary, CheckSummary
    )


def facts_of(about: Provenance) -> dict[str, str]:
    """The same for the foot of a report."""
    return {
        "command": "kedge " + " ".join(about.arguments),
        "kedge": about.version,
        **about.versions,
        "platform": about.platform or "",
        "seed": str(about.seed),
        **{f"digest of {part}": value for part, value in about.digest.items()},
    }
