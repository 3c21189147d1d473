"""What a study's report says in words: the headline, the facts below it, and its warnings."""

import numpy as np

from kedge.core.manifolds import Space
from kedge.reports import style
from kedge.reports.findings import HONEST, no_nees
from kedge.studies.claims import FALSE, TRUE
from kedge.studies.figures_of_merit import StudySummary
from kedge.studies.study import Study
from kedge.studies.summary import BASELINE

FEW_RUNS = 30
"""With fewer the intervals themselves are not well known."""
MANY_OUTLIERS = 0.1
"""Share of a sensor's readings from which a study warns: nine tenths are to be used."""


def unit_of(summary: StudySummary, states: Space) -> tuple[float, str]:
    """Factor and unit of the score that filters are judged by."""
    of = summary.score.of
    if of not in states.slices():
        units = set(states.units)
        return style.shown(units.pop()) if len(units) == 1 else (1.0, "–")
    return style.shown(states.units[states.slices()[of].start])


def headline(summary: StudySummary, states: Space) -> str:
    """The result in one sentence or two."""
    filters, of = summary.filters, summary.score.of
    factor, unit = unit_of(summary, states)
    unit = "" if unit == "–" else f"\u00a0{unit}"
    known = {n: r.score for n, r in filters.items() if np.isfinite(r.score.value)}
    if not known:
        return "No run of any filter came out finite."
    main = BASELINE if BASELINE in known else min(known, key=lambda n: known[n].value)
    value, *ends = (factor * number for number in known[main])
    shown = style.measured(value, ends)[0]
    what = "error, mean over time" if of == "time-mean-rms" else f"{style.words(of)} error"
    runs = summary.about.runs
    text = f"{main}: {shown}{unit} rms {what}, over {style.count(runs)} run{'s' * (runs > 1)}"
    others = [score.value for name, score in known.items() if name != main]
    if others and known[main].value > 0:
        ratios = [other / known[main].value for other in others]
        low, high = style.number(min(ratios)), style.number(max(ratios))
        if len(ratios) == 1:
            text += f"; the other filter has {low} times that"
        elif low == high:
            text += f"; the {len(ratios)} others have {low} times that"
        else:
            text += f"; the {len(ratios)} others have {low} to {high} times that"
    verdicts = [claim.verdict for claim in summary.claims]
    counts = [
        f"{number} {'is' if number == 1 else 'are'} {word}"
        for number, word in (
            (verdicts.count(TRUE), "true"),
            (verdicts.count(FALSE), "false"),
            (sum(v not in (TRUE, FALSE) for v in verdicts), "not decided"),
        )
        if number
    ]
    return f"{text}." + (f" Of the claims, {_joined(counts)}." if counts else "")


def facts(summary: StudySummary, study: Study) -> list[tuple[str, str]]:
    """The strip below the headline: name and value."""
    scenario, filters = study.scenario, summary.filters
    strip = [
        ("runs", style.count(summary.about.runs)),
        ("duration of a run", f"{scenario.duration:g} s"),
        ("steps of a run", style.count(scenario.steps)),
    ]
    if study.burn_in:
        strip.append(("scored after", f"{study.burn_in:g} s"))
    strip.append(("filters", str(len(filters))))
    if expected := summary.expected:
        good = sum(band.verdict == TRUE for band in expected)
        strip.append(("figures as expected", f"{good} of {len(expected)}"))
    spent = sum(row.seconds for row in filters.values())
    return [*strip, ("computing", f"{style.number(spent, 2)} s")]


def warnings(summary: StudySummary) -> list[str]:
    """What a reader should know before trusting the numbers."""
    filters, runs = summary.filters, summary.about.runs
    texts = [
        no_nees(name, row.settled.singular)
        for name, row in filters.items()
        if row.settled.singular > 0
    ]
    if runs < FEW_RUNS:
        texts.append(
            f"{runs} run{'s' * (runs > 1)}: the intervals are wide, and not well known "
            "themselves."
        )
    if failed := [f"{n} ({r.failed})" for n, r in filters.items() if r.failed]:
        texts.append(f"Runs that came out not finite, and are left out: {', '.join(failed)}.")
    poor = [
        f"{name} ({style.percent(row.settled.coverage_95.value)})"
        for name, row in filters.items()
        if np.isfinite(row.settled.nees.value) and row.settled.coverage_95.value < HONEST
    ]
    if poor:
        texts.append(
            "Over-confident, by the share of times at which the truth lies in the 95\u00a0% "
            f"ellipsoid: {', '.join(poor)}."
        )
    texts += [
        f"{name}: {style.percent(share)} of the readings of {sensor} were outliers to it."
        for name, row in filters.items()
        for sensor, share in row.settled.outlying.items()
        if share > MANY_OUTLIERS
    ]
    return texts + [
        f"Not as expected: {band.score} is {band.figures}."
        for band in summary.expected
        if band.verdict == FALSE
    ]


def _joined(parts: list[str]) -> str:
    *others, last = parts
    return f"{', '.join(others)} and {last}" if others else last
