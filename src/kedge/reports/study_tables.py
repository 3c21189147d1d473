"""The tables of a study's report: filters with intervals, windows, what others published."""

from collections.abc import Mapping, Sequence

import numpy as np

from kedge.core.manifolds import Space
from kedge.reports import style
from kedge.reports.study_figures import Filters
from kedge.reports.tables import Column, Table, number_column, score_column, table
from kedge.studies.claims import FALSE, TRUE
from kedge.studies.figures_of_merit import ExpectedFigure, WindowScores
from kedge.studies.summary import parts_of

MARKS = {TRUE: ("✓", "holds"), FALSE: ("✗", "fails")}
"""How a verdict is shown: sign and class; the others are open."""


def merit_table(filters: Filters, states: Space, settled: bool = True) -> Table:
    """Filters by figures of merit, after the burn-in or over all steps."""
    rows = {n: r.settled if settled else r.all_steps for n, r in filters.items()}
    first, columns = next(iter(filters.values())), []
    names, part, units = list(rows), next(iter(rows.values())), _units(states)
    if settled and first.score_of == "time-mean-rms":
        means = [row.time_mean_rms for row in filters.values()]
        columns.append(score_column(names, "time mean", "rms of the state", means))
    for name in part.rmse:
        factor, symbol = style.shown(units[name])
        columns.append(_rmse(rows, name, factor, symbol))
    for name in part.tracking:
        errors = [row.tracking[name] for row in rows.values()]
        columns.append(score_column(names, style.words(name), "tracking, rms", errors))
    if len(rows) > 1:
        base, of = first.baseline, first.score_of
        title = f"× {base}" if len(base) < 20 else "× the first"
        ratios = [None if name == base else row.ratios[of] for name, row in rows.items()]
        unit = f"{style.words(of)}, paired"
        columns.append(score_column(names, title, unit, ratios, rivals=False))
    columns.append(_nees(rows, first.nees_dof))
    inside = [
        row.coverage_95.value if np.isfinite(row.nees.value) else None for row in rows.values()
    ]
    columns.append(number_column(names, "inside", "95 % ellipsoid", inside, style.percent))
    for sensor, dof in part.nis_dof.items():
        unit = f"{style.number(dof)} is right" if np.isfinite(dof) else "–"
        title = "NIS" if len(part.nis_dof) == 1 else f"NIS {style.words(sensor)}"
        values = [row.nis[sensor] for row in rows.values()]
        columns.append(score_column(names, title, unit, values, rivals=False))
    return table(names, [*columns, *(_costs(filters) if settled else ())])


def window_tables(filters: Filters, states: Space) -> dict[str, Table]:
    """Scores in each of the scenario's named stretches of time, and in the rest."""
    first, names = next(iter(filters.values())), list(filters)
    tables, units, fields = {}, _units(states), list(states.slices())
    of = first.score_of if first.score_of in fields else fields[0]
    for window, scores in first.windows.items():
        rows = {name: row.windows[window] for name, row in filters.items()}
        within = [row.within_3_sigma[of] for row in rows.values()]
        title = f"{style.words(of)} in 3 σ"
        nis = [row.nis_per_dof for row in rows.values()]
        columns = [
            score_column(names, title, "worst axis", within, 1, False, style.percent),
            _nees(rows, first.nees_dof),
            number_column(names, "NIS", "by component", nis),
        ]  # first: a state of many fields runs out of the page
        for name in [*fields, *(n for n in ("horizontal",) if n in scores.rmse)]:
            columns.append(_rmse(rows, name, *style.shown(units[name])))
        tables[style.words(window)] = table(names, columns)
    return tables


def published_table(filters: Filters, factor: float, unit: str) -> list[list[str]]:
    """Filter, what was published, ours, its interval, their ratio, and who published it."""
    rows = []
    for name, scores in filters.items():
        if (entry := scores.published) is None:
            continue
        ours, *ends = (factor * number for number in scores.score)
        theirs = factor * entry.rmse
        text, interval = style.measured(ours, ends)
        cells = [f"{style.number(theirs)} {unit}".strip(), f"{text} {unit}".strip(), interval]
        rows.append([name, *cells, style.number(ours / theirs, 2), entry.source])
    return rows


def band_table(expected: Sequence[ExpectedFigure]) -> list[dict[str, str]]:
    """Expected figures: mark, score, its value here and where it should lie."""
    rows = []
    for band in expected:
        sign, kind = MARKS.get(band.verdict, ("?", "open"))
        value, _, _ = band.figures.partition(", expected")
        low, high = band.between
        between = f"{low:g} to {high:g}"
        rows.append(
            {"sign": sign, "kind": kind, "score": band.score, "found": value,
             "between": between, "source": band.source}
        )  # fmt: skip
    return rows


def _rmse(rows: Mapping[str, WindowScores], field: str, factor: float, symbol: str) -> Column:
    errors = [row.rmse[field] for row in rows.values()]
    return score_column(list(rows), style.words(field), f"{symbol} rms", errors, factor)


def _nees(rows: Mapping[str, WindowScores], dof: int) -> Column:
    values = [row.nees for row in rows.values()]
    return score_column(list(rows), "NEES", f"{dof} is right", values, rivals=False)


def _costs(filters: Filters) -> list[Column]:
    """Failed runs, and what the filters cost."""
    names, rows, columns = list(filters), filters.values(), []
    if any(row.failed for row in rows):
        failed = [row.failed for row in rows]
        columns.append(
            number_column(names, "failed", "runs", failed, lambda n: style.count(int(n or 0)))
        )
    milliseconds = [1e3 * row.seconds_per_run for row in rows]
    compiling = [row.compile_seconds for row in rows]
    return [
        *columns,
        number_column(names, "time", "ms a run", milliseconds, _two),
        number_column(names, "compiling", "s", compiling, _two),
    ]


def _two(value: float | None) -> str:
    return style.number(value, 2)


def _units(states: Space) -> dict[str, str]:
    """Of every field and component, and of whatever else has a score."""
    return {name: states.units[cut.start] for name, cut in parts_of(states).items()} | dict(
        zip(states.labels, states.units, strict=True)
    )
