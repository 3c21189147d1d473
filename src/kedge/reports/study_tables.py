"""The tables of a study's report: filters with intervals, windows, what others published."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from kedge.core.manifolds import Space
from kedge.reports import style
from kedge.reports.study_figures import Filters
from kedge.reports.tables import Cell, Column, Table, marked
from kedge.studies.claims import FALSE, TRUE
from kedge.studies.summary import parts_of

MARKS = {TRUE: ("✓", "holds"), FALSE: ("✗", "fails")}
"""How a verdict is shown: sign and class; the others are open."""


def merit_table(filters: Filters, states: Space, settled: bool = True) -> Table:
    """Filters by figures of merit, after the burn-in or over all steps."""
    rows = {n: r if settled else r["all_steps"] for n, r in filters.items()}
    first, columns = next(iter(filters.values())), []
    if settled and first["score_of"] == "time-mean-rms":
        columns.append(_interval(rows, "time mean", "rms of the state", ("time_mean_rms",)))
    units = _units(states)
    for name in first["rmse"]:
        factor, symbol = style.shown(units[name])
        columns.append(
            _interval(rows, style.words(name), f"{symbol} rms", ("rmse", name), factor)
        )
    for name in first.get("tracking", {}):
        columns.append(_interval(rows, style.words(name), "tracking, rms", ("tracking", name)))
    if len(rows) > 1:
        base, of = first["baseline"], first["score_of"]
        found = {n: None if n == base else r for n, r in rows.items()}
        title = f"× {base}" if len(base) < 20 else "× the first"
        path = ("ratios", of) if not settled else ("ratio_to_baseline",)
        columns.append(_interval(found, title, f"{style.words(of)}, paired", path, best=False))
    known = {n: r for n, r in rows.items() if r["nees"] is not None}
    columns.append(_interval(rows, "NEES", f"{first['nees_dof']} is right", ("nees",), best=0))
    columns.append(
        _plain(rows, "inside", "95 % ellipsoid",
               lambda n: known[n]["coverage_95"] if n in known else None, style.percent)
    )  # fmt: skip
    for sensor, dof in first["nis_dof"].items():
        unit = "–" if dof is None else f"{style.number(dof)} is right"
        title = "NIS" if len(first["nis_dof"]) == 1 else f"NIS {style.words(sensor)}"
        columns.append(_interval(rows, title, unit, ("nis", sensor), best=0))
    if settled:
        columns += _costs(filters)
    kept = [column for column in columns if any(cell.text != "–" for cell in column.cells)]
    return Table(list(rows), kept)


def window_tables(filters: Filters, states: Space) -> dict[str, Table]:
    """Scores in each of the scenario's named stretches of time, and in the rest."""
    first = next(iter(filters.values()))
    found, units = {}, _units(states)
    of = (
        first["score_of"]
        if first["score_of"] in states.slices()
        else next(iter(states.slices()))
    )
    for window, scores in (first.get("windows") or {}).items():
        rows = {name: row["windows"][window] for name, row in filters.items()}
        columns = []
        for name in [*states.slices(), *(n for n in ("horizontal",) if n in scores["rmse"])]:
            factor, symbol = style.shown(units[name])
            path = "rmse", name
            columns.append(_interval(rows, style.words(name), f"{symbol} rms", path, factor))
        title = f"{style.words(of)} in 3 σ"
        columns.append(_shares(rows, title, "worst axis", ("within_3_sigma", of)))
        unit = f"{first['nees_dof']} is right"
        columns.append(_interval(rows, "NEES", unit, ("nees",), best=0))
        columns.append(
            _plain(rows, "NIS", "by component", lambda n, rows=rows: rows[n]["nis_per_dof"])
        )
        columns = columns[-3:] + columns[:-3]  # a state of many fields runs out of the page
        kept = [column for column in columns if any(cell.text != "–" for cell in column.cells)]
        found[style.words(window)] = Table(list(filters), kept)
    return found


def published_table(filters: Filters, factor: float, unit: str) -> list[list[str]]:
    """Filter, what was published, ours, its interval, their ratio, and who published it."""
    rows = []
    for name, scores in filters.items():
        entry = scores.get("published")
        if not entry:
            continue
        ends = [_times(end, factor) for end in scores["score_ci"]]
        ours, theirs = _times(scores["score"], factor), factor * entry["rmse"]
        text, interval = measured(ours, ends)
        ratio = None if ours is None else ours / theirs
        cells = [f"{style.number(theirs)} {unit}".strip(), f"{text} {unit}".strip(), interval]
        rows.append([name, *cells, style.number(ratio, 2), entry["source"]])
    return rows


def band_table(expected: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Expected figures: mark, score, what was found and where it should lie."""
    found = []
    for band in expected:
        sign, kind = MARKS.get(band["verdict"], ("?", "open"))
        value, _, _ = band["figures"].partition(", expected")
        low, high = band["between"]
        between = f"{low:g} to {high:g}"
        found.append(
            {"sign": sign, "kind": kind, "score": band["score"], "found": value,
             "between": between, "source": band.get("source", "")}
        )  # fmt: skip
    return found


def measured(value: float | None, ends: Sequence[float | None]) -> tuple[str, str]:
    """A number and its interval as text; a dash for one that is not known."""
    if value is None:
        return "–", ""
    return style.measured(value, [float("nan") if end is None else end for end in ends])


def _interval(
    rows: Mapping[str, Any],
    name: str,
    unit: str,
    path: Sequence[str],
    factor: float | int = 1,
    best: bool | int = True,
) -> Column:
    """A score with its interval below; ``best`` marks the least, unless it is no rivalry."""
    cells, values = [], []
    for row in rows.values():
        value = _times(_look(row, path), factor)
        ends = _look(row, [f"{path[0]}_ci", *path[1:]]) or (None, None)
        cells.append(Cell(*measured(value, [_times(end, factor) for end in ends])))
        values.append(value)
    return Column(name, unit, marked(list(rows), cells, values) if best else cells)


def _shares(rows: Mapping[str, Any], name: str, unit: str, path: Sequence[str]) -> Column:
    """A share in percent with its interval below."""
    cells = []
    for row in rows.values():
        ends = _look(row, [f"{path[0]}_ci", *path[1:]]) or ()
        between = " to ".join(style.percent(end) for end in ends if end is not None)
        cells.append(Cell(style.percent(_look(row, path)), between))
    return Column(name, unit, cells)


def _plain(
    rows: Mapping[str, Any],
    name: str,
    unit: str,
    value: Callable[[str], float | None],
    text: Callable[[float | None], str] = style.number,
) -> Column:
    return Column(name, unit, [Cell(text(value(row))) for row in rows])


def _costs(filters: Filters) -> list[Column]:
    """Failed runs, and what the filters cost."""
    found = []
    if any(scores["failed"] for scores in filters.values()):
        found.append(
            _plain(filters, "failed", "runs", lambda n: filters[n]["failed"],
                   lambda value: style.count(int(value or 0)))
        )  # fmt: skip
    milli = _plain(
        filters, "time", "ms a run", lambda n: 1e3 * filters[n]["seconds_per_run"], _two
    )
    compiling = _plain(filters, "compiling", "s", lambda n: filters[n]["compile_seconds"], _two)
    return [*found, milli, compiling]


def _two(value: float | None) -> str:
    return style.number(value, 2)


def _look(row: Any, path: Sequence[str]) -> Any:
    for key in path:
        row = row.get(key) if isinstance(row, Mapping) else None
    return row


def _times(value: float | None, factor: float | int) -> float | None:
    return None if value is None else factor * value


def _units(states: Space) -> dict[str, str]:
    """Of every field and component, and of whatever else has a score."""
    return {name: states.units[cut.start] for name, cut in parts_of(states).items()} | dict(
        zip(states.labels, states.units, strict=True)
    )
