"""The work behind ``kedge tune``: find numbers of a rig, and judge them on other parts."""

import math
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from kedge import __version__
from kedge.apps import tune_parts as parts
from kedge.apps.console import command_line, console_progress
from kedge.apps.workflow import load_with_raw, settings
from kedge.config.filters import build_filter
from kedge.config.problem import Problem, fitted
from kedge.config.rigs import load_rig_config
from kedge.core.errors import ConfigError, DataError
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.formats.results import as_toml, plain, write_summary
from kedge.formats.results_folder import results_folder
from kedge.reports.style import save_png, svg_of
from kedge.reports.tuning_report import draw_profiles, parameter_rows
from kedge.tuning.generalisation import FARTHER, generalisation, leave_one_out
from kedge.tuning.loss import ungated
from kedge.tuning.tunable import choose
from kedge.tuning.tuning import Search, Tuned, conclude, fit

HOLD_OUT, MOST_HELD_OUT = 0.5, 0.9


class Options(NamedTuple):
    """What was asked for."""

    filter: str | None = None
    parameters: str | None = None
    with_truth: bool = False
    hold_out: float | None = None
    """Share of the log, at its end, that is not tuned on; :data:`HOLD_OUT` if not given."""
    starts: int = 4
    span: float = 1000.0
    bounds: Sequence[str] = ()
    until: float | None = None
    seed: int = 0
    changes: Sequence[str] | None = None
    figure: bool = True
    horizons: str | None = None
    """s, with commas between."""
    blocks: int | None = None
    """Of one log, each of which is left out in turn."""
    leave_one_out: bool | None = None
    """If not said, wherever there are several logs or blocks."""


def execute(rig: str, logs: Sequence[str], out: Path, options: Options) -> dict[str, Any]:
    """Tune, judge, write the folder; return the summary.

    Raises:
        KedgeError: the rig, a log or an option cannot be used; nothing is left.
    """
    leaves_out = parts.leaves_out(
        len(logs), options.blocks, options.leave_one_out, options.hold_out
    )
    hold_out = HOLD_OUT if options.hold_out is None else options.hold_out
    if leaves_out or len(logs) > 1:
        hold_out = 0.0
    if not 0 <= hold_out <= MOST_HELD_OUT:
        raise ConfigError(
            f"--hold-out: found {hold_out:g}, expected a share from 0 to {MOST_HELD_OUT:g}"
        )
    names = None if options.parameters is None else split_list(options.parameters)
    bounds = parse_bounds(options.bounds)
    horizons = parse_horizons(options.horizons)
    if horizons and options.with_truth:
        raise ConfigError("--horizons: found --with-truth as well, expected one of them")
    use_compilation_cache()
    loaded = [load_with_raw(rig, log, "auto", options.until, options.changes) for log in logs]
    problems = [problem for problem, _ in loaded]
    first = problems[0]
    parts.check_logs(logs, problems)
    spec = options.filter or first.filter
    filter = build_filter(spec)
    for log, problem in zip(logs, problems, strict=True):
        if options.with_truth and problem.truth is None:
            raise DataError(f"{log}: --with-truth: the log has no truth")
    chosen = choose(first.rig, names)
    known = {t.key for t in chosen}
    bounds = {_completed(name, known): ends for name, ends in bounds.items()}
    search = Search(options.starts, options.span, bounds, options.seed)
    share = 1 - hold_out
    cases = parts.cases_of(problems, options.with_truth, share)

    def rigged(values: Any, number: int) -> Problem:
        """A log with the rig of these values."""
        overrides: dict[str, Any] = settings(options.changes) | {"filter.name": f'"{spec}"'}
        overrides |= {t.key: float(v) for t, v in zip(chosen, values, strict=True)}
        config, raw = load_rig_config(rig, overrides), loaded[number][1]
        return fitted(config, raw, logs[number], "auto", options.until)

    with results_folder(out, "tune") as folder, console_progress() as progress:
        whole = fit(filter, cases, chosen, search, horizons, progress)
        tuned = conclude(whole)
        after = [rigged(tuned.values, number) for number in range(len(logs))]
        spans = parts.spans_of(problems, options.blocks, share)
        without = []
        if leaves_out:
            left = parts.without_each(cases, spans)
            without = leave_one_out(
                filter, left, whole, tuned.values, search, horizons, progress
            )
        progress("scores")
        scored = {
            "start": [problems[span.log] for span in spans],
            "tuned": [after[span.log] for span in spans],
        }
        if leaves_out:
            scored["left_out"] = [
                rigged(part.values, span.log) for part, span in zip(without, spans, strict=True)
            ]
        elif any(own.gate is not None for own in first.rig.sensors):
            bare = [problem._replace(rig=ungated(problem.rig)[0]) for problem in after]
            scored["tuned_ungated"] = [bare[span.log] for span in spans]
        scores = parts.scores_of(scored, spans, spec)
        for number, part in enumerate(without):
            name = spans[number].name
            for column, loss in zip(scores, part[2:], strict=True):
                scores[column][name]["loss"] = loss
        until = None if leaves_out or len(logs) > 1 else spans[0].end
        summary = summarise(problems, tuned, options, spec, until, scores)
        summary |= {"horizons": list(horizons), "logs": dict(parts.named(logs))}
        if leaves_out:
            what = "blocks" if options.blocks else "logs"
            truth = parts.certainty(scores["left_out"]), parts.growth(scores)
            verdict = generalisation(without, chosen, what, *truth)
            values = [[float(value) for value in part.values] for part in without]
            summary["generalisation"] = verdict._asdict() | {
                "parts": {
                    span.name: dict(zip([t.key for t in chosen], each, strict=True))
                    for span, each in zip(spans, values, strict=True)
                }
            }
            if verdict.status != "holds":
                summary["warnings"].append(verdict.sentence)
        for warning in summary["warnings"]:
            print(f"warning: {warning}", file=sys.stderr)
        write_summary(folder / "tune.json", summary)
        (folder / "tuned.toml").write_text(tuned_rig(rig, after[0]), encoding="utf-8")
        figure = draw_profiles(tuned) if options.figure else None
        if figure is not None:
            (folder / "profile.svg").write_text(svg_of(figure), encoding="utf-8")
            save_png(figure, folder / "profile.png")
    return plain(summary)


def summarise(
    problems: Sequence[Problem],
    tuned: Tuned,
    options: Options,
    filter: str,
    until: float | None,
    scores: Mapping[str, Any],
) -> dict[str, Any]:
    """What goes into ``tune.json``."""
    return {
        "command": "tune",
        "arguments": command_line(),
        "version": __version__,
        "platform": f"Python {platform.python_version()}, {platform.machine()}",
        "title": problems[0].title,
        "filter": filter,
        "criterion": "truth"
        if options.with_truth
        else ("horizons" if options.horizons else "innovations"),
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
        "notes": [*(note for problem in problems for note in problem.notes), *tuned.notes],
        "warnings": warnings(scores, options.with_truth),
        "inputs_digest": " ".join(problem.inputs_digest for problem in problems),
    }


def warnings(scores: Mapping[str, Any], with_truth: bool) -> list[str]:
    """What is worse with the values found than with those of the rig."""
    found, tuned = [], scores.get("left_out", scores["tuned"])
    for part, before in scores["start"].items():
        after, name = tuned[part], part.replace("_", "-")
        if after["fused"] < 0.95 * before["fused"]:
            found.append(
                f"{name} part: with the values found the rig's gates refuse more: "
                f"{after['fused']} readings are fused, {before['fused']} were before; compare "
                "the scores without gates, and widen the gates or give them a recovery"
            )
        for field, error in before.get("rmse", {}).items():
            if after["rmse"][field] > FARTHER * error:
                found.append(
                    f"{name} part: rmse of {field} is {after['rmse'][field]:.3g}, it was "
                    f"{error:.3g}"
                )
    if found and not with_truth:
        found.append(
            "errors that are correlated in time, or a model that lacks something, make "
            "readings look better than they are; try --horizons, an error with a memory "
            "(std and time constant), or --with-truth"
        )
    return found


def tuned_rig(rig: str, after: Problem) -> str:
    """The rig file with the values found; it can be used from any folder."""
    config = dict(after.config)
    if modules := config.get("modules"):
        config["modules"] = [str((Path(rig).parent / name).resolve()) for name in modules]
    return as_toml(config)


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


def parse_horizons(text: str | None) -> tuple[float, ...]:
    """What ``--horizons`` was given: seconds with commas between.

    Raises:
        ConfigError: one of them is no time above 0.
    """
    try:
        horizons = tuple(float(each) for each in split_list((text or "").replace(" ", ",")))
    except ValueError:
        horizons = (0.0,)
    if not all(0 < each < math.inf for each in horizons) or (text is not None and not horizons):
        raise ConfigError(f"--horizons {text!r}: expected seconds above 0, e.g. 1,5,20")
    return horizons


def _completed(name: str, keys: set[str]) -> str:
    """A bound may name a number by the end of its key, as ``--parameters`` may."""
    ends = [key for key in keys if key.endswith(f".{name}")]
    return name if name in keys or len(ends) != 1 else ends[0]
