"""What a study's report says in words: the headline, the facts below it, and its warnings."""

from collections.abc import Mapping
from typing import Any

from kedge.core.manifolds import Space
from kedge.reports import style
from kedge.reports.findings import HONEST, no_nees
from kedge.reports.study_tables import measured
from kedge.studies.claims import FALSE, TRUE
from kedge.studies.study import Study
from kedge.studies.summary import BASELINE

FEW_RUNS = 30
"""With fewer the intervals themselves are not well known."""


def unit_of(summary: Mapping[str, Any], states: Space) -> tuple[float, str]:
    """Factor and unit of the score that filters are judged by."""
    of = summary["score"]["of"]
    if of not in states.slices():
        units = set(states.units)
        return style.shown(units.pop()) if len(units) == 1 else (1.0, "–")
    return style.shown(states.units[states.slices()[of].start])


def headline(summary: Mapping[str, Any], states: Space) -> str:
    """The result in one sentence or two."""
    filters, of = summary["filters"], summary["score"]["of"]
    factor, unit = unit_of(summary, states)
    unit = "" if unit == "–" else f"\u00a0{unit}"
    known = {n: r for n, r in filters.items() if r["score"] is not None}
    if not known:
        return "No run of any filter came out finite."
    main = BASELINE if BASELINE in known else min(known, key=lambda n: known[n]["score"])
    value = measured(
        factor * known[main]["score"],
        [None if end is None else factor * end for end in known[main]["score_ci"]],
    )[0]
    what = "error, mean over time" if of == "time-mean-rms" else f"{style.words(of)} error"
    runs = summary["runs"]
    text = f"{main}: {value}{unit} rms {what}, over {style.count(runs)} run{'s' * (runs > 1)}"
    ratios = [r["score"] / known[main]["score"] for n, r in known.items() if n != main]
    if ratios and known[main]["score"] > 0:
        low, high = style.number(min(ratios)), style.number(max(ratios))
        if len(ratios) == 1:
            text += f"; the other filter has {low} times that"
        elif low == high:
            text += f"; the {len(ratios)} others have {low} times that"
        else:
            text += f"; the {len(ratios)} others have {low} to {high} times that"
    verdicts = [claim["verdict"] for claim in summary.get("claims", ())]
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


def facts(summary: Mapping[str, Any], study: Study) -> list[tuple[str, str]]:
    """The strip below the headline: name and value."""
    scenario, filters = study.scenario, summary["filters"]
    found = [
        ("runs", style.count(summary["runs"])),
        ("duration of a run", f"{scenario.duration:g} s"),
        ("steps of a run", style.count(scenario.steps)),
    ]
    if study.burn_in:
        found.append(("scored after", f"{study.burn_in:g} s"))
    found.append(("filters", str(len(filters))))
    if expected := summary.get("expected"):
        good = sum(band["verdict"] == TRUE for band in expected)
        found.append(("figures as expected", f"{good} of {len(expected)}"))
    spent = sum(row["seconds"] for row in filters.values())
    return [*found, ("computing", f"{style.number(spent, 2)} s")]


def warnings(summary: Mapping[str, Any]) -> list[str]:
    """What a reader should know before trusting the numbers."""
    filters, runs, found = summary["filters"], summary["runs"], []
    for name, row in filters.items():
        if (row["singular"] or 0.0) > 0:
            found.append(no_nees(name, row["singular"]))
    if runs < FEW_RUNS:
        found.append(
            f"{runs} run{'s' * (runs > 1)}: the intervals are wide, and not well known "
            "themselves."
        )
    if failed := [f"{n} ({r['failed']})" for n, r in filters.items() if r["failed"]]:
        found.append(f"Runs that came out not finite, and are left out: {', '.join(failed)}.")
    poor = [
        f"{name} ({style.percent(row['coverage_95'])})"
        for name, row in filters.items()
        if row["nees"] is not None and (row["coverage_95"] or 0.0) < HONEST
    ]
    if poor:
        found.append(
            "Over-confident, by the share of times at which the truth lies in the 95\u00a0% "
            f"ellipsoid: {', '.join(poor)}."
        )
    for band in summary.get("expected", ()):
        if band["verdict"] == FALSE:
            found.append(f"Not as expected: {band['score']} is {band['figures']}.")
    return found


def _joined(parts: list[str]) -> str:
    *others, last = parts
    return f"{', '.join(others)} and {last}" if others else last
