"""The report: one page that reads without a network, with its figures beside it."""

from pathlib import Path
from typing import NamedTuple

from kedge.core.errors import DataError
from kedge.estimation.log import Recording, Truth
from kedge.estimation.rig import Rig
from kedge.evaluation.score import Run
from kedge.reports import diagnostics, figures, findings, maps, spatial, style, tables
from kedge.reports.drawing import LONG_GAP
from kedge.reports.page import Front, Plate, require_studio, write_page


class ReportContent(NamedTuple):
    """All that a report is made of: the runs of one log, and where they come from."""

    title: str
    runs: list[Run]
    recording: Recording
    rig: Rig
    truth: Truth | None
    target_names: dict[str, tuple[str, ...]]
    """By sensor, the ids on its map."""
    configuration: str
    """The resolved rig, as text."""
    facts: dict[str, str]
    """Versions, seed, digest, command."""
    notes: list[str]
    """What the reader of the files had to say."""


def write_report(folder: Path, content: ReportContent) -> Path:
    """Write ``report.html`` and its figures; return the page's path.

    The same content gives the same bytes.

    Raises:
        KedgeError: matplotlib or jinja2 is not installed.
        DataError: there is no run to report on.
    """
    if not content.runs:
        raise DataError("a report needs a run, found none")
    require_studio()
    runs, recording, rig = content.runs, content.recording, content.rig
    front = Front(
        kicker="kedge · estimation report",
        title=content.title,
        headline=findings.headline(runs, recording),
        strip=findings.facts(runs, recording),
        warnings=findings.warnings(runs, recording, rig),
    )
    return write_page(
        folder,
        "report.html.j2",
        front,
        plates(content),
        content=content,
        principal=findings.principal(runs).name,
        filters=tables.filter_table(runs, recording),
        sensors=tables.sensor_table(findings.principal(runs), rig),
        verdicts=tables.verdict_table(runs, rig),
        targets=tables.target_table(findings.principal(runs).scores, findings.units_of(rig)),
        looks=style.looks([run.name for run in runs]),
        facts=content.facts,
        configuration=content.configuration,
    )


def plates(content: ReportContent) -> list[Plate]:
    """The figures that this log has something to show in."""
    run = findings.principal(content.runs)
    listed = [*_map(content)] if hasattr(run.track.mean, "position") else []
    listed += _heights(content, run) + _errors(content)
    if figures.unknown_to_truth(run):
        what = "The state" if run.errors is None else "What truth does not know of the state"
        listed.append(
            Plate(
                "states",
                "states",
                f"{what}, as {run.name} estimates it, with ± 3 standard deviations.",
                figures.plot_states(run, color=_color(content, run))[0].figure,
            )
        )
    return listed + _consistency(content, run) + _verdicts(content, run)


def _color(content: ReportContent, run: Run) -> str:
    return style.looks([other.name for other in content.runs])[run.name].color


def _map(content: ReportContent) -> list[Plate]:
    runs, truth = content.runs, content.truth
    if len(runs) == 1:
        axes = [maps.plot_map(runs, truth, maps.target_map(content.rig, content.target_names))]
    else:
        axes = maps.plot_maps(runs, truth, maps.target_map(content.rig, content.target_names))
    caption = "The paths in plan, with 95\u00a0% ellipses of the filters at even intervals."
    strays = [run.name for run in runs if maps.leaves(run, axes[0])]
    if strays:
        caption += f" Cut off at the edge of the view: {', '.join(strays)}."
    return [Plate("map", "map", caption, axes[0].figure)]


def _heights(content: ReportContent, run: Run) -> list[Plate]:
    """Height and attitude of what moves in space."""
    listed, truth = [], content.truth
    if spatial.is_spatial(run):
        rivals = [run for run in content.runs if spatial.is_spatial(run)]
        caption = f"The height, with ± 3 standard deviations of {run.name}."
        figure = spatial.plot_heights(rivals, run, truth).figure
        listed.append(Plate("height", "map", caption, figure))
    if spatial.has_attitude(run):
        caption = (
            f"The attitude that {run.name} estimates, with ± 3 standard deviations: how the "
            "body would be turned by heading, then pitch, then roll."
        )
        axes = spatial.plot_attitude(run, truth, color=_color(content, run))
        listed.append(Plate("attitude", "map", caption, axes[0].figure))
    return listed


def _errors(content: ReportContent) -> list[Plate]:
    judged = [run for run in content.runs if run.errors is not None]
    if not judged:
        return []
    listed, main = [], findings.principal(content.runs)
    if len(judged) > 1:
        caption = "Distance from truth, all runs, on a logarithmic axis."
        listed.append(
            Plate("distance", "errors", caption, figures.plot_distance(judged).figure)
        )
    truth = content.truth
    if truth is not None and "position" in truth.fields and spatial.is_spatial(main):
        caption = "Position error in per cent of the distance covered so far, all runs."
        figure = spatial.plot_drift(judged, truth).figure
        listed.append(Plate("drift", "errors", caption, figure))
    shown = [run for run in judged if run is main or not style.is_baseline(run.name)]
    for run in sorted(shown, key=lambda run: run is not main):
        axes = figures.plot_errors(run, color=_color(content, run))
        caption = (
            f"Errors of {run.name} by component, in the band of ± 3 standard deviations that "
            f"it claims. Shaded: more than {LONG_GAP:g}\u00a0s without a fused reading."
        )
        name = f"errors-{content.runs.index(run) + 1}"
        listed.append(Plate(name, "errors", caption, axes[0].figure, run is not main))
    return listed


def _consistency(content: ReportContent, run: Run) -> list[Plate]:
    listed, judged = [], [other for other in content.runs if other.errors is not None]
    if judged:
        axes = figures.plot_nees(judged)
        caption = (
            "Normalised estimation error squared; an honest filter stays below the bound "
            "95\u00a0% of the time."
        )
        listed.append(Plate("nees", "consistency", caption, axes[0].figure))
    parts = run, content.recording, content.rig
    names = [installation.name for installation in content.rig.sensors]
    sizes = {name: len(diagnostics.innovations(*parts, name).nis) for name in names}
    shown = [name for name in names if sizes[name] > 1]
    if not shown:
        return listed
    rows = len(shown)
    axes = style.subplots(rows, 1, 2.7 * rows)[:, 0]
    for ax, name in zip(axes, shown, strict=True):
        diagnostics.plot_nis(*parts, name, ax)
    caption = (
        f"Normalised innovation squared of {run.name}, reading by reading, with its one-sided "
        "bound, and the running mean in the bounds that it keeps 95\u00a0% of the time if the "
        "model is right."
    )
    heavy = [s.name for s in content.rig.sensors if s.robust is not None]
    if heavy:
        caption += f" Noise with heavy tails ({', '.join(heavy)}): chi-square is a guide only."
    listed.append(Plate("nis", "consistency", caption, axes[0].figure))
    axes = style.subplots(rows, 2, 2.7 * rows)
    for (left, right), name in zip(axes, shown, strict=True):
        diagnostics.plot_nis_histogram(*parts, name, left)
        if diagnostics.testable(diagnostics.innovations(*parts, name)):
            diagnostics.plot_whiteness(*parts, name, right)
        else:
            right.remove()
    caption = (
        f"Left: how NIS is distributed, against the chi-square law. Right: autocorrelation of "
        f"the whitened innovations of {run.name}."
    )
    return [*listed, Plate("innovations", "consistency", caption, axes[0, 0].figure)]


def _verdicts(content: ReportContent, run: Run) -> list[Plate]:
    if not diagnostics.verdict_rows(run, content.recording, content.rig):
        return []
    ax = diagnostics.plot_verdicts(run, content.recording, content.rig)
    caption = f"What became of each reading, {run.name}; right of each row, how many."
    return [Plate("verdicts", "verdicts", caption, ax.figure)]
