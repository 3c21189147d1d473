"""The work behind ``kedge allan``: the noise of an IMU from a record of it standing still."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from kedge import __version__
from kedge.calibration.allan import AllanCurve, AllanFit, allan, fit
from kedge.config.readings import find_table
from kedge.core.errors import DataError
from kedge.estimation.log import SECOND
from kedge.formats.logs import digest_inputs
from kedge.formats.readers import read_log
from kedge.formats.results import write_csv, write_summary
from kedge.formats.results_folder import results_folder
from kedge.reports.allan_figure import draw_allan
from kedge.reports.style import save_png, subplots, svg_of


def execute(log: str, format: str, source: str | None, out: Path | None) -> dict[str, Any]:
    """Compute, fit, write the folder; return the summary.

    Raises:
        KedgeError: the log cannot be read, or has no signals with enough samples.
    """
    raw = read_log(log, format)
    name = source or next(iter(raw.tables))
    table = find_table(raw, name, "--source")
    steps = np.diff(table.stamps) / SECOND
    if len(steps) == 0 or not np.median(steps) > 0:
        raise DataError(f"{table.path}: {name}: found no time between samples, expected some")
    period, notes = float(np.median(steps)), list(raw.notes)
    if (gaps := int((steps > 1.5 * period).sum())) > 0:
        notes.append(f"{name}: {gaps} gaps; samples are taken as if there were none")
    signals: dict[str, dict[str, AllanCurve]] = {}
    for column, values in table.columns.items():
        if not np.isfinite(values).all():
            raise DataError(f"{table.path}: {name}: column {column!r} is not complete")
        stem = re.sub(r"_[xyz]$", "", column)
        try:
            signals.setdefault(stem, {})[column] = allan(values, period)
        except DataError as error:
            raise DataError(f"{table.path}: {name}: {error}") from None
    fitted = {stem: fit(list(curves.values())) for stem, curves in signals.items()}
    units = {stem: table.units[next(iter(curves))] for stem, curves in signals.items()}
    summary = {
        "command": "allan",
        "version": __version__,
        "source": name,
        "period": period,
        "samples": len(table.stamps),
        "signals": {
            stem: {
                "unit": units[stem],
                **fitted[stem]._asdict(),
                "axes": {axis: fit([curve])._asdict() for axis, curve in curves.items()},
            }
            for stem, curves in signals.items()
        },
        "notes": notes,
        "inputs": digest_inputs(raw),
    }
    if out is not None:
        with results_folder(out, "allan") as folder:
            _write(folder, summary, signals, fitted, units)
    return summary


def _write(
    folder: Path,
    summary: dict[str, Any],
    signals: dict[str, dict[str, AllanCurve]],
    fitted: dict[str, AllanFit],
    units: dict[str, str],
) -> None:
    write_summary(folder / "summary.json", summary)
    curves = {axis: curve for by_axis in signals.values() for axis, curve in by_axis.items()}
    columns = {"tau": next(iter(curves.values())).tau}
    write_csv(
        folder / "table.csv",
        columns | {axis: curve.deviation for axis, curve in curves.items()},
    )
    (folder / "figures").mkdir()
    axes = subplots(1, len(signals), height=3.4)[0]
    for ax, (stem, by_axis) in zip(axes, signals.items(), strict=True):
        draw_allan(by_axis, fitted[stem], units[stem], ax, stem.replace("_", " "))
    figure = axes[0].figure
    (folder / "figures" / "allan.svg").write_text(svg_of(figure), encoding="utf-8")
    save_png(figure, folder / "figures" / "allan.png")


def print_allan(summary: dict[str, Any]) -> None:
    """A table of what was fitted, with the units of each coefficient."""
    for stem, signal in summary["signals"].items():
        unit = signal["unit"]
        print(f"{stem} ({unit}, {summary['samples']} samples at {1 / summary['period']:g} Hz)")
        print(f"  {'axis':24s} {'N /sqrt(Hz)':>12s} {'B':>12s} {'K /s/sqrt(Hz)':>14s}")
        for axis, values in (signal["axes"] | {"all": signal}).items():
            print(
                f"  {axis:24s} {values['noise']:12.4g} {values['instability']:12.4g} "
                f"{values['walk']:14.4g}"
            )
