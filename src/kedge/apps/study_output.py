"""What ``kedge study`` and ``kedge merge`` leave and print."""

import csv
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from kedge import __version__
from kedge.config.scenarios import Setting
from kedge.estimation.compiled import compiler
from kedge.formats.results import as_toml, digest, flatten, plain, write_summary, write_table
from kedge.reports import study_findings as findings
from kedge.reports.findings import said
from kedge.reports.study_report import StudyContent
from kedge.studies.claims import (
    FALSE,
    OPEN,
    TRUE,
    Evidence,
    judge,
    judge_band,
    look_up,
)
from kedge.studies.scores import Result, Tally
from kedge.studies.study import Study, plan_of
from kedge.studies.summary import blank, summarise_study, windows


def write_study(
    folder: Path, summary: Mapping[str, Any], results: Mapping[str, Result]
) -> None:
    """Summary, table and runs; the report is written apart."""
    write_summary(folder / "summary.json", summary)
    write_table(folder / "table.csv", summary["filters"])
    _write_runs(folder / "runs.csv", results)


def content_of(study: Study, tally: Tally, summary: Mapping[str, Any]) -> StudyContent:
    """What the report is drawn from."""
    shown = {
        key: value
        for key, value in summary["configuration"].items()
        if key
        not in ("claims", "errata", "expected", "published", "quoted")  # the page has them
    }
    facts = {
        "command": "kedge " + " ".join(summary["arguments"]),
        "kedge": summary["version"],
        **summary["versions"],
        "platform": summary["platform"],
        "seed": str(summary["seed"]),
        **{f"digest of {part}": value for part, value in summary["digest"].items()},
    }
    return StudyContent(
        study,
        tally.results(),
        tally.truth,
        tally.readings,
        summary,
        as_toml(shown),
        facts,
        summary["configuration"]["scenario"]["featured"],
    )


def summary_of(
    setting: Setting, study: Study, results: Mapping[str, Result], runs: int
) -> dict[str, Any]:
    """What goes into ``summary.json``; the digest pins configuration and result."""
    about = setting.config.scenario
    filters = summarise_study(study, results)
    for name in filters:
        if name in setting.config.published:
            entry = setting.config.published[name]
            source = entry.source or about.source
            filters[name]["published"] = {"rmse": entry.rmse, "source": source}
    plan = plan_of(study)
    for name, result in results.items():
        if plan.windows:
            filters[name]["windows"] = windows(study, plan, result)
    configuration = setting.config.model_dump(mode="json", exclude_none=True)
    # Without the last, which follows from what is not in it: digests outlive a new score.
    scores = [
        digest(name, *map(np.asarray, (*result.runs[:-1], *result.whole[:-1])))
        for name, result in results.items()
    ]
    parts = {"configuration": digest(configuration), "result": digest(*scores)}
    found = {
        "command": "study",
        "arguments": sys.argv[1:],
        "version": __version__,
        "versions": {n: version(n) for n in ("jax", "equinox", "numpy")} | compiler(),
        "platform": f"Python {platform.python_version()}, {platform.machine()}",
        "title": about.title,
        "source": about.source,
        "seed": study.seed,
        "runs": runs,
        "score": {"name": study.score, "of": next(iter(filters.values()))["score_of"]},
        "filters": filters,
        **_judged(setting, Evidence(study, results, filters)),
        "configuration": configuration,
        "digest": {**parts, "all": digest(parts)},
    }
    summary = plain(found)
    return summary | {"warnings": said(findings.warnings(summary))}


def score_names(setting: Setting, study: Study, filters: Sequence[str]) -> list[str]:
    """Every number that the study will leave, as ``--require`` names it."""
    found = summary_of(setting, study, {"any": blank(study)}, 1)["filters"]["any"]
    scores = [name for name, value in flatten(found) if not isinstance(value, str)]
    published = [f"{name}.published.rmse" for name in setting.config.published]
    return [f"{name}.{score}" for name in filters for score in scores] + published


def _judged(setting: Setting, evidence: Evidence) -> dict[str, Any]:
    """Expected figures and claims with their verdicts, and errata, where a scenario has any."""
    config = setting.config
    expected = []
    for band in config.expected:
        low, high = band.between
        verdict, figures = judge_band(band.score, low, high, evidence)
        expected.append(band.model_dump() | {"verdict": verdict, "figures": figures})
    claims = []
    for claim in config.claims:
        verdict, figures = judge(claim.test, evidence)
        claims.append(claim.model_dump() | {"verdict": verdict, "figures": figures})
    quoted = []
    for entry in config.quoted:
        here = look_up(entry.score, evidence)
        ours = {"here": None} if here is None else {"here": here.mean, "here_ci": [*here[1:]]}
        quoted.append(entry.model_dump() | ours)
    found = {"quoted": quoted, "expected": expected, "claims": claims}
    found |= {"errata": list(config.errata)}
    return {key: value for key, value in found.items() if value}


def print_study(summary: Mapping[str, Any]) -> None:
    """The table of filters, the published score beside ours."""
    from rich.console import Console
    from rich.table import Table

    score, rows = summary["score"], summary["filters"]
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("filter", no_wrap=True)
    published = any(row.get("published") for row in rows.values())
    failed = any(row["failed"] for row in rows.values())
    dof = next(iter(rows.values()))["nees_dof"]
    known = any(row["singular"] is not None for row in rows.values())
    base, several = next(iter(rows.values()))["baseline"], len(rows) > 1
    titles = [score["of"], "95 % interval"] + ["published"] * published
    against = base if len(base) < 16 else "the first"
    titles += [f"x {against}", "95 % interval"] * several
    titles += [f"NEES ({dof} right)", "in 95 % bound"] * known
    titles += ["failed runs"] * failed + ["s/run"]
    for title in titles:
        table.add_column(title, justify="right")
    for name, row in rows.items():
        cells = [_shown(row["score"]), _between(row["score_ci"])]
        cells += [_shown((row.get("published") or {}).get("rmse"))] * published
        ratio = [_shown(row["ratio_to_baseline"]), _between(row["ratio_to_baseline_ci"])]
        cells += (["-", "-"] if name == base else ratio) * several
        nees = "singular" if (row["singular"] or 0.0) > 0 else _shown(row["nees"])
        cells += [nees, _covered(row)] * known
        cells += [str(row["failed"])] * failed + [_shown(row["seconds_per_run"], ".2g")]
        table.add_row(name, *cells)
    console = Console(width=None if sys.stdout.isatty() else 180, highlight=False)
    console.print(f"{summary['title']}: {summary['runs']} runs, seed {summary['seed']}")
    console.print(table)
    entries = [row["published"] for row in rows.values() if row.get("published")]
    for source in sorted({entry["source"] for entry in entries}):
        console.print(f"published: {source}", markup=False, soft_wrap=True)

    def progress(*lines: str) -> None:
        for line in lines:
            console.print(line, markup=False, soft_wrap=True)

    for entry in summary.get("quoted", ()):
        here = "not here" if entry["here"] is None else f"here {entry['here']:.4g}"
        progress(f"{entry['source']}: {entry['score']} {entry['value']:g}; {here}")
    for band in summary.get("expected", ()):
        mark = {TRUE: "as expected", FALSE: "NOT as expected"}.get(band["verdict"], OPEN)
        progress(f"{mark}: {band['score']} {band['figures']}")
    for claim in summary.get("claims", ()):
        progress("", f"claim: {claim['text']} ({claim['source']})")
        progress(f"  {claim['verdict']}: {claim['figures']}")
        if claim["means"]:
            progress(f"  {claim['means']}")
    if summary.get("errata"):
        progress("", "errata:", *(f"  {text}" for text in summary["errata"]))


def _covered(row: Mapping[str, Any]) -> str:
    """A share in the 95 % bound; none where the covariance has no inverse."""
    return "-" if row["nees"] is None else _shown(row["coverage_95"], ".0%")


def _between(ends: Sequence[float | None]) -> str:
    low, high = ends
    return "-" if low is None or high is None else f"[{low:.3g}, {high:.3g}]"


def _shown(value: float | None, form: str = ".3g") -> str:
    return "-" if value is None else format(value, form)


def _write_runs(path: Path, results: Mapping[str, Result]) -> None:
    """One row a run and filter, for statistics of one's own; written as they are made."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["filter", "run", "time_mean_rms", "mean_squared_error", "nees"])
        for name, (runs, *_) in results.items():
            squared = np.asarray(runs.squared).sum(axis=1)
            columns = np.asarray(runs.time_mean_rms), squared, np.asarray(runs.nees)
            for run, row in enumerate(zip(*columns, strict=True)):
                writer.writerow([name, run, *(float(x) if np.isfinite(x) else "" for x in row)])
