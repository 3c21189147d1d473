"""The work behind ``kedge tune``: find numbers of a rig, judge them on the rest of the log."""

import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from kedge import __version__
from kedge.apps.console import command_line, console_progress, printer
from kedge.apps.workflow import load_with_raw, settings
from kedge.config.filters import build_filter
from kedge.config.problem import Problem, fitted
from kedge.config.rigs import load_rig_config
from kedge.core.errors import ConfigError, DataError
from kedge.estimation.batch import estimate
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.evaluation.score import score
from kedge.formats.results import as_toml, plain, write_summary
from kedge.formats.results_folder import results_folder
from kedge.reports.style import save_png, svg_of
from kedge.reports.tuning_report import draw_profiles, parameter_rows, part_scores
from kedge.tuning.loss import ungated
from kedge.tuning.tunable import choose
from kedge.tuning.tuning import Search, Tuned, tune

MOST_HELD_OUT = 0.9
WORSE = 1.1
"""By this factor an error must grow to be worth a warning."""


class Options(NamedTuple):
    """What was asked for."""

    filter: str | None = None
    parameters: str | None = None
    with_truth: bool = False
    hold_out: float = 0.5
    """Share of the log, at its end, that is not tuned on."""
    starts: int = 4
    span: float = 1000.0
    bounds: Sequence[str] = ()
    until: float | None = None
    seed: int = 0
    changes: Sequence[str] | None = None
    figure: bool = True


def execute(rig: str, log: str, out: Path, options: Options) -> dict[str, Any]:
    """Tune, judge, write the folder; return the summary.

    Raises:
        KedgeError: the rig, the log or an option cannot be used; nothing is left.
    """
    if not 0 <= options.hold_out <= MOST_HELD_OUT:
        raise ConfigError(
            f"--hold-out: found {options.hold_out:g}, expected a share from 0 to "
            f"{MOST_HELD_OUT:g}"
        )
    names = None if options.parameters is None else split_list(options.parameters)
    bounds = parse_bounds(options.bounds)
    use_compilation_cache()
    problem, raw = load_with_raw(rig, log, "auto", options.until, options.changes)
    spec = options.filter or problem.filter
    filter = build_filter(spec)
    if options.with_truth and problem.truth is None:
        raise DataError(f"{log}: --with-truth: the log has no truth")
    chosen = choose(problem.rig, names)
    known = {t.key for t in chosen}
    bounds = {_completed(name, known): ends for name, ends in bounds.items()}
    search = Search(options.starts, options.span, bounds, options.seed)
    duration = float(problem.recording.log.schedule.time[-1])
    until = duration * (1 - options.hold_out)
    with results_folder(out, "tune") as folder, console_progress() as progress:
        truth = problem.truth if options.with_truth else None
        tuned = tune(
            filter, problem.rig, problem.recording, chosen, truth, until, search, progress
        )
        progress("scores")
        overrides: dict[str, Any] = settings(options.changes) | {"filter.name": f'"{spec}"'}
        overrides |= {t.key: float(v) for t, v in zip(chosen, tuned.values, strict=True)}
        after = fitted(load_rig_config(rig, overrides), raw, log, "auto", options.until)
        cases = {"start": problem, "tuned": after}
        if any(own.gate is not None for own in problem.rig.sensors):
            cases["tuned_ungated"] = after._replace(rig=ungated(after.rig)[0])
        scores = {
            name: _scores(name, spec, found, until, duration) for name, found in cases.items()
        }
        summary = summarise(problem, tuned, options, spec, until, scores)
        for warning in summary["warnings"]:
            print(f"warning: {warning}", file=sys.stderr)
        write_summary(folder / "tune.json", summary)
        (folder / "tuned.toml").write_text(tuned_rig(rig, after), encoding="utf-8")
        figure = draw_profiles(tuned) if options.figure else None
        if figure is not None:
            (folder / "profile.svg").write_text(svg_of(figure), encoding="utf-8")
            save_png(figure, folder / "profile.png")
    return plain(summary)


def summarise(
    problem: Problem,
    tuned: Tuned,
    options: Options,
    filter: str,
    until: float,
    scores: Mapping[str, Any],
) -> dict[str, Any]:
    """What goes into ``tune.json``."""
    return {
        "command": "tune",
        "arguments": command_line(),
        "version": __version__,
        "platform": f"Python {platform.python_version()}, {platform.machine()}",
        "title": problem.title,
        "filter": filter,
        "criterion": "truth" if options.with_truth else "innovations",
        "tuned_until": until,
        "seed": options.seed,
        "parameters": parameter_rows(tuned),
        "flat": list(tuned.flat),
        "loss": {
            "start": tuned.loss_before,
            "tuned": tuned.loss_after,
            "judged": tuned.judged,
        },
        "starts": [
            {"loss": attempt.loss, "evaluations": attempt.evaluations}
            for attempt in tuned.attempts
        ],
        "agreed": tuned.agreed,
        "scores": scores,
        "notes": [*problem.notes, *tuned.notes],
        "warnings": warnings(scores, options.with_truth),
        "inputs_digest": problem.inputs_digest,
    }


def warnings(scores: Mapping[str, Any], with_truth: bool) -> list[str]:
    """What is worse with the values found than with those of the rig."""
    found = []
    for part, before in scores["start"].items():
        after, name = scores["tuned"][part], part.replace("_", "-")
        if after["fused"] < 0.95 * before["fused"]:
            found.append(
                f"{name} part: with the values found the rig's gates refuse more: "
                f"{after['fused']} readings are fused, {before['fused']} were before; compare "
                "the scores without gates, and widen the gates or give them a recovery"
            )
        for field, error in before.get("rmse", {}).items():
            if after["rmse"][field] > WORSE * error:
                found.append(
                    f"{name} part: rmse of {field} is {after['rmse'][field]:.3g}, it was "
                    f"{error:.3g}"
                )
    if found and not with_truth:
        found.append(
            "errors that are correlated in time, or a model that lacks something, make "
            "readings look better than they are; try --with-truth"
        )
    return found


def tuned_rig(rig: str, after: Problem) -> str:
    """The rig file with the values found; it can be used from any folder."""
    config = dict(after.config)
    if modules := config.get("modules"):
        config["modules"] = [str((Path(rig).parent / name).resolve()) for name in modules]
    return as_toml(config)


def print_tuned(summary: Mapping[str, Any]) -> None:
    """The table of numbers, what the log says of them, and the scores before and after."""
    from rich.table import Table

    console = printer()
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("parameter", "start", "found", "factor", "std error", "identified"):
        table.add_column(
            name, justify="left" if name in ("parameter", "identified") else "right"
        )
    for row in summary["parameters"]:
        factor = row["factor"]
        table.add_row(
            row["key"], f"{row['start']:.4g}", f"{row['found']:.4g}",
            "-" if factor is None else f"{factor:.3g}", _uncertainty(row), row["verdict"],
        )  # fmt: skip
    console.print(table)
    for sentence in summary["flat"]:
        console.print(f"flat: {sentence}", markup=False, soft_wrap=True)
    loss = summary["loss"]
    console.print(
        f"loss by {'output time' if summary['criterion'] == 'truth' else 'reading'}: "
        f"{loss['start']:.4g} -> {loss['tuned']:.4g}; {summary['agreed']} of "
        f"{len(summary['starts'])} starts agree\n"
    )
    for part in summary["scores"]["start"]:
        several = {name: parts[part] for name, parts in summary["scores"].items()}
        said = ", ".join(_said(several))
        names = " -> ".join(several).replace("_", " ")
        console.print(f"{part.replace('_', '-')} part ({names}): {said}", soft_wrap=True)


def _uncertainty(row: Mapping[str, Any]) -> str:
    error = row["std_error"]
    if error is None or error > 10:
        return "-"
    return f"{100 * error:.2g} %" if row["of_logarithm"] else f"{error:.2g}"


def _said(several: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Each score as it was and as it is."""
    first = next(iter(several.values()))
    rows: list[tuple[str, tuple[str, ...]]]
    rows = [(f"rmse {field}", ("rmse", field)) for field in first.get("rmse", {})]
    for name in ("nees", "nis"):
        if f"{name}_dof" in first:
            rows.append((f"{name} (of {first[f'{name}_dof']:.3g})", (name,)))
    found = []
    for title, path in [*rows, ("fused", ("fused",))]:
        values = []
        for scores in several.values():
            value: Any = scores
            for key in path:
                value = value.get(key, {})
            values.append(f"{value:.3g}" if isinstance(value, float) else f"{value or '-'}")
        found.append(f"{title} {' -> '.join(values)}")
    return found


def split_list(text: str) -> list[str]:
    """Names with commas between them."""
    return [name.strip() for name in text.split(",") if name.strip()]


def parse_bounds(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """What ``--bounds`` was given: ``KEY=LOW:HIGH``.

    Raises:
        ConfigError: one of them is something else.
    """
    found = {}
    for text in texts:
        key, _, ends = text.partition("=")
        low, _, high = ends.partition(":")
        try:
            found[key.strip()] = float(low), float(high)
        except ValueError:
            raise ConfigError(
                f"--bounds {text!r}: expected KEY=LOW:HIGH, e.g. sensors.gnss.latency=0:0.3"
            ) from None
    return found


def _completed(name: str, keys: set[str]) -> str:
    """A bound may name a number by the end of its key, as ``--parameters`` may."""
    ends = [key for key in keys if key.endswith(f".{name}")]
    return name if name in keys or len(ends) != 1 else ends[0]


def _scores(
    name: str, filter: str, problem: Problem, until: float, duration: float
) -> dict[str, Any]:
    found = estimate(build_filter(filter), problem.rig, problem.recording.log)
    run = score(name, found, problem.recording, problem.rig, problem.truth)
    parts = {"tuning": (-1.0, until)}
    if until < duration:
        parts["held_out"] = (until, duration + 1.0)
    return {part: part_scores(run, *ends) for part, ends in parts.items()}
