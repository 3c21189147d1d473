"""What ``kedge study`` and ``kedge merge`` leave and print."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from kedge.apps.console import printer
from kedge.apps.summaries import facts_of, provenance
from kedge.config.scenarios import Setting
from kedge.evaluation.record import by_name, record
from kedge.evaluation.scores import Score
from kedge.formats.results import as_toml, digest, plain, write_csv, write_summary, write_table
from kedge.reports import study_findings as findings
from kedge.reports.findings import said
from kedge.reports.study_report import StudyContent
from kedge.studies.claims import FALSE, OPEN, TRUE, Evidence, judge_band, judge_claim, look_up
from kedge.studies.figures_of_merit import (
    ExpectedFigure,
    Headline,
    JudgedClaim,
    PublishedScore,
    QuotedFigure,
    StudySummary,
    WindowScores,
)
from kedge.studies.scores import Result, Tally
from kedge.studies.study import Study
from kedge.studies.summary import blank, summarise_study


def write_study(folder: Path, summary: StudySummary, results: Mapping[str, Result]) -> None:
    """Summary, table and runs; the report is written apart."""
    write_summary(folder / "summary.json", record(summary))
    write_table(folder / "table.csv", plain(record(summary.filters)))
    _write_runs(folder / "runs.csv", results)


def content_of(study: Study, tally: Tally, summary: StudySummary) -> StudyContent:
    """What the report is drawn from."""
    configuration = summary.about.configuration
    shown = {
        key: value
        for key, value in configuration.items()
        if key
        not in ("claims", "errata", "expected", "published", "quoted")  # the page has them
    }
    return StudyContent(
        study,
        tally.results(),
        tally.truth,
        tally.readings,
        summary,
        as_toml(shown),
        facts_of(summary.about),
        configuration["scenario"]["featured"],
        configuration["scenario"]["panels"],
    )


def summary_of(
    setting: Setting, study: Study, results: Mapping[str, Result], runs: int
) -> StudySummary:
    """What goes into ``summary.json``; the digest pins configuration and result."""
    filters = summarise_study(study, results)
    for name, entry in setting.config.published.items():
        if name in filters:
            source = entry.source or setting.config.scenario.source
            published = PublishedScore(entry.rmse, source)
            filters[name] = replace(filters[name], published=published)
    # Without the last, which follows from what is not in it: digests outlive a new score.
    scores = [
        digest(name, *map(np.asarray, (*result.runs[:-1], *result.whole[:-1])))
        for name, result in results.items()
    ]
    about = provenance(
        "study",
        setting.config.scenario.title,
        setting.config.model_dump(mode="json", exclude_none=True),
        {"result": digest(*scores)},
        seed=study.seed,
        runs=runs,
    )
    summary = StudySummary(
        about,
        source=setting.config.scenario.source,
        score=Headline(study.score, next(iter(filters.values())).score_of),
        filters=filters,
        **_judged(setting, Evidence(study, results, filters)),
    )
    warnings = tuple(said(findings.warnings(summary)))
    return replace(summary, about=replace(about, warnings=warnings))


def score_names(setting: Setting, study: Study, filters: Sequence[str]) -> list[str]:
    """Every number that the study will leave, as ``--require`` names it."""
    scores = by_name(summary_of(setting, study, {"any": blank(study)}, 1).filters["any"])
    published = [f"{name}.published.rmse" for name in setting.config.published]
    return [f"{name}.{score}" for name in filters for score in scores] + published


class Verdicts(TypedDict):
    """What a study makes of the figures and claims of its scenario."""

    quoted: tuple[QuotedFigure, ...]
    expected: tuple[ExpectedFigure, ...]
    claims: tuple[JudgedClaim, ...]
    errata: tuple[str, ...]


def _judged(setting: Setting, evidence: Evidence) -> Verdicts:
    config = setting.config
    configuration = config.model_dump(mode="json")
    return Verdicts(
        quoted=tuple(
            QuotedFigure(
                **entry.model_dump(), here=look_up(entry.score, evidence) or Score(math.nan)
            )
            for entry in config.quoted
        ),
        expected=tuple(
            ExpectedFigure(
                **band.model_dump(),
                **judge_band(band.score, band.between, evidence)._asdict(),
            )
            for band in config.expected
        ),
        claims=tuple(judge_claim(claim, evidence, configuration) for claim in config.claims),
        errata=tuple(config.errata),
    )


def print_study(summary: StudySummary) -> None:
    """The table of filters, the published score beside ours."""
    from rich.table import Table

    rows = summary.filters
    first = next(iter(rows.values()))
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("filter", no_wrap=True)
    published = any(row.published for row in rows.values())
    failed = any(row.failed for row in rows.values())
    known = any(np.isfinite(row.settled.singular) for row in rows.values())
    several = len(rows) > 1
    titles = [summary.score.of, "95 % interval"] + ["published"] * published
    against = first.baseline if len(first.baseline) < 16 else "the first"
    titles += [f"x {against}", "95 % interval"] * several
    titles += [f"NEES ({first.nees_dof} right)", "in 95 % bound"] * known
    titles += ["failed runs"] * failed + ["s/run"]
    for title in titles:
        table.add_column(title, justify="right")
    for name, row in rows.items():
        cells = [_shown(row.score.value), _between(row.score)]
        cells += [_shown(row.published.rmse if row.published else None)] * published
        ratio = [_shown(row.ratio_to_baseline.value), _between(row.ratio_to_baseline)]
        cells += (["-", "-"] if name == row.baseline else ratio) * several
        cells += _honesty(row.settled) * known
        cells += [str(row.failed)] * failed + [_shown(row.seconds_per_run, ".2g")]
        table.add_row(name, *cells)
    console = printer(180)
    about = summary.about
    console.print(f"{about.title}: {about.runs} runs, seed {about.seed}")
    console.print(table)
    sources = sorted({row.published.source for row in rows.values() if row.published})
    for source in sources:
        console.print(f"published: {source}", markup=False, soft_wrap=True)

    def progress(*lines: str) -> None:
        for line in lines:
            console.print(line, markup=False, soft_wrap=True)

    for entry in summary.quoted:
        here = f"here {entry.here:.4g}" if np.isfinite(entry.here.value) else "not here"
        progress(f"{entry.source}: {entry.score} {entry.value:g}; {here}")
    for band in summary.expected:
        mark = {TRUE: "as expected", FALSE: "NOT as expected"}.get(band.verdict, OPEN)
        progress(f"{mark}: {band.score} {band.figures}")
    for claim in summary.claims:
        progress("", f"claim: {claim.text} ({claim.source})")
        progress(f"  {claim.verdict}: {claim.figures}")
        if claim.means:
            progress(f"  {claim.means}")
    if summary.errata:
        progress("", "errata:", *(f"  {text}" for text in summary.errata))


def _honesty(scores: WindowScores) -> list[str]:
    """NEES and the share in the 95 % bound; neither where the covariance has no inverse."""
    if scores.singular > 0:
        return ["singular", "-"]
    inside = scores.coverage_95.value if np.isfinite(scores.nees.value) else None
    return [_shown(scores.nees.value), _shown(inside, ".0%")]


def _between(score: Score) -> str:
    return f"[{score.lower:.3g}, {score.upper:.3g}]" if np.isfinite(score[1:]).all() else "-"


def _shown(value: float | None, form: str = ".3g") -> str:
    return "-" if value is None or not np.isfinite(value) else format(value, form)


def _write_runs(path: Path, results: Mapping[str, Result]) -> None:
    """One row a run and filter, for statistics of one's own."""
    scores = [result.runs for result in results.values()]
    counts = [len(runs.nees) for runs in scores]
    columns = {
        "filter": np.repeat(list(results), counts),
        "run": np.concatenate([np.arange(count) for count in counts]),
        "time_mean_rms": np.concatenate([runs.time_mean_rms for runs in scores]),
        "mean_squared_error": np.concatenate([runs.squared.sum(axis=1) for runs in scores]),
        "nees": np.concatenate([runs.nees for runs in scores]),
    }
    write_csv(path, columns)
