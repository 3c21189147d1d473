"""The tables of a report: filters by figures of merit, sensors, verdicts."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from kedge.core.verdicts import Verdict
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig
from kedge.evaluation.by_target import targets_off
from kedge.evaluation.consistency import chi_square_interval
from kedge.evaluation.score import Run
from kedge.evaluation.scores import FilterScores, Score
from kedge.reports import style
from kedge.reports.figures import main_field
from kedge.reports.findings import baseline, cost, inside


class Cell(NamedTuple):
    """What a table shows at one place."""

    text: str
    detail: str = ""
    best: bool = False


class Column(NamedTuple):
    """A figure of merit: its name and unit, and how far from best each run is."""

    name: str
    unit: str
    cells: list[Cell]


class Table(NamedTuple):
    """Rows by name, columns by figure of merit."""

    rows: list[str]
    columns: list[Column]


def filter_table(runs: Sequence[Run], recording: Recording) -> Table:
    """Runs by figures of merit; the best filter's value is marked where that makes sense."""
    base, columns, names = baseline(runs), [], [run.name for run in runs]
    judged = next((run for run in runs if run.errors is not None), None)
    if judged is not None and judged.errors is not None:
        field, main = main_field(judged.errors)[0], judged.errors
        units = {name: main.units[cut.start] for name, cut in main.fields.items()}
        extra = {"horizontal": ("position", "m"), "heading": ("attitude", "rad")}
        for name, (source, unit) in extra.items():
            if source in main.fields and name in judged.scores.rmse.keys() - main.fields:
                units[name] = unit
        for name, unit in units.items():
            factor, symbol = style.shown(unit)
            scores = [run.scores.rmse[name] for run in runs]
            columns.append(
                score_column(names, style.words(name), f"{symbol} rms", scores, factor)
            )
        if base is not None and base.errors is not None and len(runs) > 1:
            title = f"against {base.name.replace('-', ' ')}"
            ratios = [_ratio(run, base, field) for run in runs]
            columns.append(number_column(names, title, "ratio", ratios, _two, 0))
        columns += [
            number_column(names, "NEES", "by component", [*map(_nees, runs)], _two, 1),
            number_column(
                names, "inside", "95 % bound", [*map(inside, runs)], style.percent, 0.95
            ),
            number_column(names, "APE", "m, rigid", _rms(runs, "ape", "rigid"), _two, 0),
            number_column(names, "RPE", "m in 10 m", _rms(runs, "rpe", "10_m"), _two, 0),
            number_column(
                names, "final error", "of distance", [*map(_final, runs)], style.percent, 0
            ),
        ]
    costs = [cost(run, recording) for run in runs]
    columns += [
        number_column(names, "NIS", "by component", [*map(_nis, runs)], _two, 1),
        number_column(names, "time", "µs an event", costs, _two, 0),
    ]
    return table(names, columns)


def sensor_table(run: Run, rig: Rig) -> list[list[str]]:
    """By sensor: readings, gate, what was refused, NIS with its bounds, whiteness."""
    rows = []
    for installation in rig.sensors:
        entry = run.scores.sensors[installation.name]
        total, gate = entry.readings, installation.gate
        refused = entry.verdicts.get(Verdict.GATED.name, 0)
        row = [
            installation.name,
            style.count(total),
            "no gate" if gate is None else style.percent(gate),
            style.percent(refused / total) if total else "–",
        ]
        fused = entry.verdicts.get(Verdict.FUSED.name, 0)
        row.append(style.number(entry.nis))
        if entry.nis_dof is not None:
            bounds = chi_square_interval(entry.nis_dof, fused)
            row.append(" to ".join(style.number(b) for b in bounds))
        else:
            row.append("–")
        test = entry.whiteness
        row += (
            [style.number(test.lag_1, 2), "yes" if test.white else "no"] if test else ["–", "–"]
        )
        rows.append(row)
    return rows


def verdict_table(runs: Sequence[Run], rig: Rig) -> tuple[list[str], list[list[str]]]:
    """Head and rows: how many readings of which sensor met which verdict, by run."""
    sensors = [(run, s.name, run.scores.sensors[s.name]) for run in runs for s in rig.sensors]
    kinds = [v for v in Verdict if any(v.name in entry.verdicts for *_, entry in sensors)]
    rows = [
        [run.name, name, *(style.count(entry.verdicts.get(v.name, 0)) for v in kinds)]
        for run, name, entry in sensors
    ]
    return ["run", "sensor", *(style.words(v.name.lower()) for v in kinds)], rows


def table(rows: Sequence[str], columns: Sequence[Column]) -> Table:
    """A table of the columns that have anything to show."""
    filled = [column for column in columns if any(cell.text != "–" for cell in column.cells)]
    return Table(list(rows), filled)


def score_column(
    rows: Sequence[str],
    name: str,
    unit: str,
    scores: Sequence[Score | None],
    factor: float | int = 1,
    rivals: bool = True,
    text: Callable[[float], str] | None = None,
) -> Column:
    """Scores with their intervals below; of ``rivals`` the least is marked as the best."""
    cells, values = [], []
    for score in scores:
        value, *ends = (factor * number for number in score or Score(math.nan))
        if text is None:
            cells.append(Cell(*style.measured(value, ends)))
        else:
            between = " to ".join(text(end) for end in ends if np.isfinite(end))
            cells.append(Cell(text(value), between))
        values.append(value)
    return Column(name, unit, marked(rows, cells, values) if rivals else cells)


def number_column(
    rows: Sequence[str],
    name: str,
    unit: str,
    values: Sequence[float | None],
    text: Callable[[float | None], str] = style.number,
    ideal: float | int | None = None,
) -> Column:
    """Numbers without intervals; the one nearest to an ``ideal`` is marked."""
    cells = [Cell(text(value)) for value in values]
    if ideal is not None:
        distances = [None if value is None else abs(value - ideal) for value in values]
        cells = marked(rows, cells, distances)
    return Column(name, unit, cells)


def marked(
    names: Sequence[str], cells: list[Cell], distances: Sequence[float | None]
) -> list[Cell]:
    """Mark the best of the filters, if there are several; the baseline is no rival."""
    rivals = [
        (d, i)
        for i, (name, d) in enumerate(zip(names, distances, strict=True))
        if d is not None and np.isfinite(d) and not style.is_baseline(name)
    ]
    if len({cells[i].text for _, i in rivals}) > 1:
        shown = cells[min(rivals)[1]].text
        for _, i in rivals:  # equal as far as significant is equally good
            cells[i] = cells[i]._replace(best=cells[i].text == shown)
    return cells


def _two(value: float | None) -> str:
    return style.number(value, 2)


def _ratio(run: Run, base: Run, field: str) -> float | None:
    errors = run.scores.rmse[field].value, base.scores.rmse[field].value
    return None if run is base else errors[0] / errors[1]


def _rms(runs: Sequence[Run], kind: Literal["ape", "rpe"], over: str) -> list[float | None]:
    """Of pose errors, where the path is long enough for them."""
    errors = [getattr(run.scores, kind).get(over) for run in runs]
    return [None if error is None else error.rmse for error in errors]


def _nees(run: Run) -> float | None:
    nees, dof = run.scores.nees, run.scores.nees_dof
    return None if nees is None or dof is None else nees / dof


def _final(run: Run) -> float | None:
    return run.scores.final_error_of_distance


def _nis(run: Run) -> float | None:
    """Of all sensors, by what was fused of each."""
    parts = [
        (sensor.verdicts[Verdict.FUSED.name], sensor.nis, sensor.nis_dof)
        for sensor in run.scores.sensors.values()
        if sensor.nis is not None and sensor.nis_dof is not None
    ]
    freedom = sum(count * dof for count, _, dof in parts)
    return sum(count * nis for count, nis, _ in parts) / freedom if parts else None


def target_table(
    scores: FilterScores, units: Mapping[str, Mapping[str, str]]
) -> list[list[str]]:
    """A row for each component of each target: readings, gated, median, spread."""
    worst = {(off.sensor, off.target, off.component) for off in targets_off(scores, units)}
    rows = []
    for sensor, entry in scores.sensors.items():
        for target, about in entry.targets.items():
            for label, unit in units.get(sensor, {}).items():
                if label not in about.residuals:
                    continue
                residual, (factor, symbol) = about.residuals[label], style.shown(unit)
                name = f"{sensor}: {target}"
                if len(units[sensor]) > 1:
                    name += f", {style.words(label)}"
                rows.append(
                    [
                        name,
                        style.count(about.readings),
                        style.percent(about.gated / about.readings),
                        f"{style.number(factor * residual.median)} {symbol}",
                        f"{style.number(factor * residual.spread)} {symbol}",
                        style.number(residual.standardised, 2),
                        "yes" if (sensor, target, label) in worst else "",
                    ]
                )
    return rows
