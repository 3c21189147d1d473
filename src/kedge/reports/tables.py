"""The tables of a report: filters by figures of merit, sensors, verdicts."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kedge.core.verdicts import Verdict
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig
from kedge.evaluation.by_target import targets_off
from kedge.evaluation.consistency import chi_square_interval
from kedge.evaluation.score import Run
from kedge.reports import style
from kedge.reports.figures import main_field
from kedge.reports.findings import baseline, cost, driven, inside


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
    base, columns = baseline(runs), []
    judged = next((run for run in runs if run.errors is not None), None)
    if judged is not None and judged.errors is not None:
        field, main = main_field(judged.errors)[0], judged.errors
        for name, cut in main.fields.items():
            columns.append(_rmse(runs, name, *style.shown(main.units[cut.start])))
        extra = {"horizontal": ("position", "m"), "heading": ("attitude", "rad")}
        for name, (source, unit) in extra.items():
            if source in main.fields and name in judged.scores["rmse"].keys() - main.fields:
                columns.append(_rmse(runs, name, *style.shown(unit)))
        if base is not None and base.errors is not None and len(runs) > 1:
            title = f"against {base.name.replace('-', ' ')}"
            columns.append(_plain(runs, title, "ratio", lambda run: _ratio(run, base, field)))
        columns += [
            _plain(runs, "NEES", "by component", _nees, ideal=1),
            _plain(
                runs,
                "inside",
                "95 % bound",
                inside,
                style.percent,
                0.95,
            ),
            _plain(runs, "APE", "m, rigid", lambda run: run.scores["ape"]["rigid"]["rmse"]),
            _plain(runs, "RPE", "m in 10 m", lambda run: run.scores["rpe"]["10_m"]["rmse"]),
            _plain(runs, "final error", "of distance", _final, style.percent),
        ]
    columns += [
        _plain(runs, "NIS", "by component", _nis, ideal=1),
        _plain(runs, "time", "µs an event", lambda run: cost(run, recording)),
    ]
    known = [column for column in columns if any(cell.text != "–" for cell in column.cells)]
    return Table([run.name for run in runs], known)


def sensor_table(run: Run, rig: Rig) -> list[list[str]]:
    """By sensor: readings, gate, what was refused, NIS with its bounds, whiteness."""
    rows = []
    for installation in rig.sensors:
        entry = run.scores["sensors"][installation.name]
        total, gate = entry["readings"], installation.gate
        refused = entry["verdicts"].get(Verdict.GATED.name, 0)
        row = [
            installation.name,
            style.count(total),
            "no gate" if gate is None else style.percent(gate),
            style.percent(refused / total) if total else "–",
        ]
        fused = entry["verdicts"].get(Verdict.FUSED.name, 0)
        if "nis" in entry:
            bounds = chi_square_interval(entry["nis_dof"], fused)
            row += [style.number(entry["nis"]), " to ".join(style.number(b) for b in bounds)]
        else:
            row += ["–", "–"]
        test = entry.get("whiteness")
        row += (
            [style.number(test["lag_1"], 2), "yes" if test["white"] else "no"]
            if test
            else ["–", "–"]
        )
        rows.append(row)
    return rows


def verdict_table(runs: Sequence[Run], rig: Rig) -> tuple[list[str], list[list[str]]]:
    """Head and rows: how many readings of which sensor met which verdict, by run."""
    sensors = [
        (run, s.name, run.scores["sensors"][s.name]) for run in runs for s in rig.sensors
    ]
    kinds = [v for v in Verdict if any(v.name in entry["verdicts"] for *_, entry in sensors)]
    rows = [
        [run.name, name, *(style.count(entry["verdicts"].get(v.name, 0)) for v in kinds)]
        for run, name, entry in sensors
    ]
    return ["run", "sensor", *(style.words(v.name.lower()) for v in kinds)], rows


def _rmse(runs: Sequence[Run], field: str, factor: float, unit: str) -> Column:
    values, cells = [], []
    for run in runs:
        value = factor * run.scores["rmse"][field]
        ends = [factor * end for end in run.scores["rmse_ci"][field]]
        values.append(value)
        cells.append(Cell(*style.measured(value, ends)))
    return Column(
        style.words(field), f"{unit} rms", marked([run.name for run in runs], cells, values)
    )


def _plain(
    runs: Sequence[Run],
    name: str,
    unit: str,
    value: Callable[[Run], float | None],
    text: Callable[[float | None], str] = lambda value: style.number(value, 2),
    ideal: float | int = 0,
) -> Column:
    values = []
    for run in runs:
        try:
            values.append(value(run))
        except KeyError:  # a score that this log has no use for
            values.append(None)
    distances = [None if v is None else abs(v - ideal) for v in values]
    names, cells = [run.name for run in runs], [Cell(text(v)) for v in values]
    return Column(name, unit, marked(names, cells, distances))


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


def _ratio(run: Run, base: Run, field: str) -> float | None:
    return None if run is base else run.scores["rmse"][field] / base.scores["rmse"][field]


def _nees(run: Run) -> float:
    return run.scores["nees"] / run.scores["nees_dof"]


def _final(run: Run) -> float | None:
    return run.scores["final_error"] / run.scores["distance"] if driven(run) else None


def _nis(run: Run) -> float | None:
    """Of all sensors, by what was fused of each."""
    entries = [entry for entry in run.scores["sensors"].values() if "nis" in entry]
    sizes = [entry["verdicts"][Verdict.FUSED.name] for entry in entries]
    if not entries:
        return None
    total = sum(n * entry["nis"] for n, entry in zip(sizes, entries, strict=True))
    return total / sum(n * entry["nis_dof"] for n, entry in zip(sizes, entries, strict=True))


def target_table(
    scores: Mapping[str, Any], units: Mapping[str, Mapping[str, str]]
) -> list[list[str]]:
    """A row for each component of each target: readings, gated, median, spread."""
    worst = {(off.sensor, off.target, off.component) for off in targets_off(scores, units)}
    rows = []
    for sensor, entry in scores["sensors"].items():
        for target, about in entry.get("targets", {}).items():
            for label, unit in units.get(sensor, {}).items():
                if label not in about:
                    continue
                part, (factor, symbol) = about[label], style.shown(unit)
                name = f"{sensor}: {target}"
                if len(units[sensor]) > 1:
                    name += f", {style.words(label)}"
                rows.append(
                    [
                        name,
                        style.count(about["readings"]),
                        style.percent(about["gated"] / about["readings"]),
                        f"{style.number(factor * part['median'])} {symbol}",
                        f"{style.number(factor * part['spread'])} {symbol}",
                        style.number(part["standardised"], 2),
                        "yes" if (sensor, target, label) in worst else "",
                    ]
                )
    return rows
