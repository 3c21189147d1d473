"""The work behind ``kedge locate``: a fix for every epoch of ranges in a log."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from kedge import __version__
from kedge.apps.console import command_line, console_progress, print_table
from kedge.apps.output import file_name
from kedge.apps.summaries import provenance
from kedge.apps.workflow import load
from kedge.config.filters import build_filter
from kedge.config.problem import Problem
from kedge.core.errors import ConfigError, DataError
from kedge.core.manifolds import charts_of
from kedge.core.registry import unknown
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.estimation.log import SECOND
from kedge.evaluation.fix_scores import FixScores, LocateSummary, score_fixes
from kedge.evaluation.record import record
from kedge.evaluation.truth import truth_at
from kedge.formats.results import as_toml, digest, write_csv, write_summary, write_table
from kedge.formats.results_folder import results_folder
from kedge.positioning.epochs import Epochs, epochs_of
from kedge.positioning.fix import Fix, Status
from kedge.positioning.links import Links
from kedge.positioning.solver import solve_all
from kedge.reports.fixes import plot_fixes, plot_residuals, residual_rows
from kedge.reports.page import Front, Plate, require_studio, write_page


class Options(NamedTuple):
    """What was asked for."""

    solvers: Sequence[str] = ("ls", "gls", "ml", "ml:loss=huber")
    sensor: str | None = None
    window: float = 0.1
    truth: str = "auto"
    until: float | None = None
    changes: Sequence[str] | None = None
    report: bool = True


class Heard(NamedTuple):
    """The epochs of one sensor."""

    time: Float[np.ndarray, " n"]
    links: Links
    anchors: Float[np.ndarray, "m d"]
    names: tuple[str, ...]


def execute(rig: str, log: str, out: Path, options: Options) -> LocateSummary:
    """Solve, score, write the folder; return the summary.

    Raises:
        KedgeError: the rig, the log or an option cannot be used; nothing is left.
    """
    solvers = {name: _solver(name) for name in options.solvers}
    if options.report:
        require_studio()
    use_compilation_cache()
    problem = load(rig, log, options.truth, options.until, options.changes)
    heard = epochs_in(problem, options.sensor, options.window)
    position = problem.rig.prior.mean.position
    with results_folder(out, "locate") as folder, console_progress() as progress:
        fixes, scores = {}, {}
        truth = known = None
        if problem.truth is not None and "position" in problem.truth.fields:
            charts = charts_of(type(problem.rig.prior.mean))
            found, known = truth_at(problem.truth, heard.time, {"position": charts["position"]})
            truth = found["position"]
        for name, solver in solvers.items():
            progress(f"{name}: {len(heard.time)} epochs")
            fixes[name] = jax.tree.map(np.asarray, solve_all(solver, heard.links, position))
            scores[name] = score_fixes(fixes[name], truth, known)
            stem = f"fixes_{file_name(name)}.csv"
            write_csv(folder / stem, columns_of(problem, heard, fixes[name]))
        result = digest(*(np.asarray(leaf) for leaf in jax.tree.leaves(fixes)))
        about = provenance(
            "locate",
            problem.title,
            problem.config,
            {"inputs": problem.inputs_digest, "result": result},
            notes=problem.notes,
        )
        epochs = len(heard.time)
        summary = LocateSummary(about, heard.names, epochs, options.window, scores)
        write_summary(folder / "summary.json", record(summary))
        write_table(folder / "table.csv", record(scores))
        if options.report:
            progress("drawing the report")
            shown = None if truth is None or known is None else truth[known]
            _report(folder, problem, heard, fixes, scores, shown)
    return summary


def epochs_in(problem: Problem, sensor: str | None, window: float) -> Heard:
    """The ranges of a log's sensor, by epoch.

    Raises:
        DataError: no sensor measures ranges, or none was heard.
        ConfigError: several do and none is chosen, or the one that is does not.
    """
    mean = problem.rig.prior.mean
    able = {
        own.name: (index, own)
        for index, own in enumerate(problem.rig.sensors)
        if hasattr(mean, "position") and own.ranging(mean, jnp.asarray(0)) is not None
    }
    if not able:
        raise DataError("locate: no sensor of the rig measures ranges to anchors")
    if sensor is None and len(able) > 1:
        raise ConfigError(f"locate: --sensor: expected one of {list(able)}")
    if sensor is not None and sensor not in able:
        raise ConfigError(f"locate: {unknown('sensor of ranges', sensor, list(able))}")
    index, own = able[sensor or next(iter(able))]
    schedule = problem.recording.log.schedule
    fired = np.flatnonzero(np.asarray(schedule.sensor) == index)
    time, row = np.asarray(schedule.time)[fired], np.asarray(schedule.row)[fired]
    readings = problem.recording.log.readings[index]
    values = np.concatenate(
        [np.asarray(z).reshape(len(z), -1) for z in jax.tree.leaves(readings.measurement)], 1
    )[row]
    if len(values) == 0:
        raise DataError(f"locate: sensor {own.name!r} has no readings")
    every = jnp.arange(own.targets or 1)
    told: Any = jax.vmap(lambda target: own.ranging(mean, target))(every)
    noise = jax.vmap(lambda target: jnp.diag(own.noise_cov(mean, target)))(every)
    told = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(-1, *leaf.shape[2:]), told)
    std = np.sqrt(np.asarray(noise).ravel())
    count = len(told.scale)
    names = problem.target_names.get(own.name, tuple(str(i + 1) for i in range(count)))
    if own.targets is None:
        found = Epochs(time, values, np.tile(row[:, None], (1, count)))
    else:
        target = np.asarray(readings.target)[row]
        if strange := int((target < 0).sum()):
            problem.notes.append(
                f"{own.name}: {strange} ranges of anchors that are not on the map, or that "
                "stand in the log twice, were left out"
            )
        found = epochs_of(time, target, values[:, 0], count, window)
    lifted = (std / told.scale, told.excess / told.scale, told.rise)
    each = [jnp.broadcast_to(jnp.asarray(leaf), found.ranges.shape) for leaf in lifted]
    shape = (len(found.time), *told.anchors.shape)
    links = Links(
        jnp.broadcast_to(jnp.asarray(told.anchors), shape),
        jnp.asarray((found.ranges - told.bias[None]) / told.scale[None]),
        *each,
    )
    return Heard(found.time, links, told.anchors, names)


def columns_of(problem: Problem, heard: Heard, fix: Any) -> dict[str, np.ndarray]:
    """One row an epoch, for a table."""
    size = heard.anchors.shape[1]
    stamps: Int[np.ndarray, " n"] = problem.recording.start + np.round(
        heard.time * SECOND
    ).astype(np.int64)
    spread = np.sqrt(np.diagonal(fix.cov, axis1=1, axis2=2))
    found: dict[str, np.ndarray] = {"stamp_ns": stamps}
    for group, values in (("position", fix.position), ("std", spread), ("mirror", fix.mirror)):
        found |= {f"{group}_{axis}": values[:, i] for i, axis in enumerate("xyz"[:size])}
    found["covariance_xy"] = fix.cov[:, 0, 1]
    for name in ("crlb", "pdop", "hdop", "vdop", "redundancy"):
        found[name] = getattr(fix, name)
    found["status"] = np.array([Status(int(s)).name for s in fix.status])
    for number, name in enumerate(heard.names):
        found[f"residual_{name}"] = fix.residual[:, number]
    return found


def _solver(spec: str) -> Any:
    name, _, rest = spec.partition(":")
    filter: Any = build_filter(f"fix:solver={name}" + (f",{rest}" if rest else ""))
    return filter.solving()


def _report(
    folder: Path,
    problem: Problem,
    heard: Heard,
    fixes: dict[str, Fix],
    scores: dict[str, FixScores],
    truth: np.ndarray | None,
) -> None:
    judged = {name: row.rmse["position"] for name, row in scores.items() if row.rmse}
    best = min(judged, key=lambda name: judged[name]) if judged else list(scores)[-1]
    headline = f"{len(heard.time)} epochs of up to {len(heard.names)} ranges."
    if judged:
        headline += f" Best: {best}, {judged[best]:.3f} m RMSE."
    plates = [
        Plate(
            "fixes",
            "fixes",
            "Every fix, in plan. Each is by itself: nothing is smoothed.",
            plot_fixes(fixes, heard.anchors, heard.names, truth),
        ),
        Plate(
            "residuals",
            "residuals",
            f"Measured range less the distance to the fix of {best}, by anchor.",
            plot_residuals(heard.time, fixes[best], heard.names),
        ),
    ]
    front = Front("kedge · locate", problem.title, headline, [], [])
    write_page(
        folder, "locate.html.j2", front, plates,
        solvers=solver_table(scores), residuals=residual_rows(fixes[best], heard.names),
        principal=best, notes=list(problem.notes), configuration=as_toml(problem.config),
        facts={"command": "kedge " + " ".join(command_line()), "kedge": __version__},
    )  # fmt: skip


COLUMNS: dict[str, Callable[[FixScores], float | None]] = {
    "RMSE, m": lambda row: row.rmse.get("position"),
    "median, m": lambda row: row.median,
    "95 %, m": lambda row: row.p95,
    "NEES": lambda row: row.nees,
    "fixes": lambda row: row.fixes,
    "ambiguous": lambda row: row.ambiguous,
    "too few": lambda row: row.too_few,
    "redundancy": lambda row: row.redundancy,
    "DOP": lambda row: row.pdop,
    "bound, m": lambda row: row.crlb,
}


def solver_table(scores: Mapping[str, FixScores]) -> tuple[list[str], list[list[str]]]:
    """The scores by solver, as text; columns that nobody has are left out."""

    def cell(value: float | None) -> str:
        if value is None or not np.isfinite(value):
            return "-"
        return f"{value}" if isinstance(value, int) else f"{value:.3g}"

    columns = {
        title: [cell(of(row)) for row in scores.values()] for title, of in COLUMNS.items()
    }
    columns = {title: cells for title, cells in columns.items() if set(cells) != {"-"}}
    rows = [
        [name, *row]
        for name, row in zip(scores, zip(*columns.values(), strict=True), strict=True)
    ]
    return ["solver", *columns], rows


def print_fixes(summary: LocateSummary) -> None:
    """The table of solvers."""
    print_table(*solver_table(summary.filters))
