"""The work behind ``estimate``, ``compare`` and ``demo``: filters over one recorded log."""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import jax
import jax.random as jr
import numpy as np

from kedge.apps.console import console_progress
from kedge.apps.output import write_results
from kedge.apps.summaries import facts_of, provenance
from kedge.config.filters import build_filter
from kedge.config.problem import Problem, fitted, read_raw
from kedge.config.rigs import load_rig_config
from kedge.core.errors import ConfigError
from kedge.estimation.batch import Estimates, compile_estimate
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.estimation.most_probable import most_probable
from kedge.estimation.smoother import compile_smoother
from kedge.estimation.transition import is_smoothable
from kedge.evaluation.score import Run, in_the_map, score
from kedge.evaluation.scores import LogSummary, Provenance
from kedge.filters.wrappers.hypotheses import Hypotheses
from kedge.formats.logs import RawLog
from kedge.formats.results import as_toml, digest
from kedge.formats.results_folder import results_folder
from kedge.reports.findings import principal, said, warnings
from kedge.reports.page import require_studio
from kedge.reports.report import ReportContent, write_report

SMOOTHER, MAP = "+smoother", "+map"
BASELINE = "dead-reckoning"


def load(
    rig: str, log: str, truth: str, until: float | None, changes: Sequence[str] | None
) -> Problem:
    """Read a rig and a log.

    Raises:
        KedgeError: either cannot be used; one message says where and why.
    """
    return load_with_raw(rig, log, truth, until, changes)[0]


def load_with_raw(
    rig: str, log: str, truth: str, until: float | None, changes: Sequence[str] | None
) -> tuple[Problem, RawLog]:
    """The same, and the log as it was recorded, to which other rigs can be fitted.

    Raises:
        KedgeError: either cannot be used; one message says where and why.
    """
    with console_progress() as progress:
        progress(f"reading {log}")
        config = load_rig_config(rig, settings(changes))
        raw = read_raw(config, log)
        problem = fitted(config, raw, log, truth, until)
    for note in problem.notes:
        print(f"note: {note}", file=sys.stderr)
    return problem, raw


def execute(
    problem: Problem,
    names: Sequence[str],
    out: Path,
    command: str,
    seed: int,
    report: bool = True,
    force: bool = False,
) -> LogSummary:
    """Run the filters, write the folder of results with its report, return the summary.

    Raises:
        KedgeError: a filter cannot run, or the folder cannot be written; nothing is left.
    """
    if report:
        require_studio()
    use_compilation_cache()
    with results_folder(out, "estimate", force) as folder, console_progress() as progress:
        runs = run_filters(problem, names, seed, progress)
        summary = summarise(problem, runs, command, seed)
        progress("writing results")
        write_results(folder, problem, runs, summary)
        if report:
            progress("drawing the report")
            write_report(folder, content_of(problem, runs, summary.about))
    return summary


def run_filters(
    problem: Problem, names: Sequence[str], seed: int, progress: Callable[[str], None]
) -> list[Run]:
    """Run every filter named over the log.

    ``NAME+smoother`` is the smoothed pass of NAME, ``NAME+map`` the most probable trajectory.

    Raises:
        ConfigError: a name stands twice, or is no filter.
        ContractError: a filter cannot run on the rig.
    """
    if len(set(names)) < len(names):
        raise ConfigError(f"filters: {','.join(names)}: found a name twice, expected each once")
    filters = {name: build_filter(_filter_of(name)) for name in names}
    done: dict[str, tuple[Estimates, Any, float]] = {}
    runs = []
    for name, chosen in filters.items():
        base = _filter_of(name)
        keep = f"{base}{SMOOTHER}" in filters
        if isinstance(chosen, Hypotheses):
            # What is smoothed is one of them, not the pass of the mixture.
            base, keep = name, name.endswith(SMOOTHER)
        if name.endswith(MAP):
            progress(f"{name}: compiling")
            likely = most_probable(
                chosen,
                problem.rig,
                problem.recording,
                jr.key(seed),
                lambda text, name=name: progress(f"{name}: {text}"),
            )
            done[name] = likely.estimates, None, likely.seconds
            base = name
        if base not in done:
            progress(f"{base}: compiling")
            call = compile_estimate(
                chosen, problem.rig, problem.recording.log, keep, jr.key(seed)
            )
            progress(f"{base}: {len(problem.recording.stamps)} events")
            (found, history), seconds = _timed(call)
            done[base] = found, history, seconds
        estimates, history, seconds = done[base]
        if name.endswith(SMOOTHER):
            progress(f"{name}: backwards")
            moments, more = _timed(compile_smoother(estimates.moments, history))
            estimates, seconds = estimates._replace(moments=moments), seconds + more
        progress(f"{name}: scores")
        run = score(
            name,
            estimates,
            problem.recording,
            problem.rig,
            problem.truth,
            problem.target_names,
        )
        events = len(problem.recording.stamps)
        each = seconds / events * 1e6
        scores = replace(run.scores, seconds=seconds, microseconds_per_event=each)
        runs.append(run._replace(scores=replace(scores, digest=_result_digest(run))))
    return _against_baseline(runs)


def _filter_of(name: str) -> str:
    return name.removesuffix(SMOOTHER).removesuffix(MAP)


def with_smoothers(names: Sequence[str]) -> list[str]:
    """The filters, and behind them the smoothed passes of those that can be smoothed."""
    plain = [name for name in names if not name.endswith((SMOOTHER, MAP))]
    filters = {name: build_filter(name) for name in plain}
    smoothed = [
        f"{name}{SMOOTHER}"
        for name, filter in filters.items()
        if is_smoothable(filter) or isinstance(filter, Hypotheses)
    ]
    return list(dict.fromkeys([*names, *smoothed]))


def summarise(problem: Problem, runs: Sequence[Run], command: str, seed: int) -> LogSummary:
    """What goes into ``summary.json``; the digest pins inputs, configuration and result."""
    about = provenance(
        command,
        problem.title,
        problem.config,
        {
            "inputs": problem.inputs_digest,
            "result": digest({run.name: run.scores.digest for run in runs}),
        },
        seed=seed,
        notes=tuple(problem.notes),
        warnings=said(warnings(runs, problem.recording, problem.rig)),
    )
    return LogSummary(
        about,
        filters={run.name: run.scores for run in runs},
        verdicts={
            run.name: {sensor: entry.verdicts for sensor, entry in run.scores.sensors.items()}
            for run in runs
        },
        events=len(problem.recording.stamps),
        duration=float(problem.recording.log.schedule.time[-1]),
    )


def content_of(problem: Problem, runs: Sequence[Run], about: Provenance) -> ReportContent:
    """What the report is drawn from."""
    with catch_warnings(action="ignore"):  # the scores have given them
        truth = problem.truth and in_the_map(problem.truth, principal(runs).track)
    return ReportContent(
        title=problem.title,
        runs=list(runs),
        recording=problem.recording,
        rig=problem.rig,
        truth=truth,
        target_names=problem.target_names,
        configuration=as_toml(problem.config),
        facts=facts_of(about),
        notes=list(problem.notes),
    )


def _timed(call: Callable[[], Any]) -> tuple[Any, float]:
    before = time.perf_counter()
    found = jax.block_until_ready(call())
    return found, time.perf_counter() - before


def _against_baseline(runs: list[Run]) -> list[Run]:
    """Position RMSE as a ratio to dead reckoning, if that is among the runs."""
    errors = {run.name: run.scores.rmse.get("position") for run in runs}
    if (base := errors.get(BASELINE)) is None or not base.value > 0:
        return runs
    return [
        run._replace(scores=replace(run.scores, ratio_to_baseline=error.value / base.value))
        for run in runs
        if (error := errors[run.name]) is not None
    ]


def _result_digest(run: Run) -> str:
    leaves = jax.tree.leaves((run.track.mean, run.track.cov, run.estimates.outcome.verdict))
    return digest(*(np.asarray(leaf) for leaf in leaves))


def settings(changes: Sequence[str] | None) -> dict[str, str]:
    """What ``--set`` was given: dotted key -> value as TOML.

    Raises:
        ConfigError: one of them is no KEY=VALUE.
    """
    found = {}
    for text in changes or ():
        key, separator, value = text.partition("=")
        if not separator or not key:
            raise ConfigError(f"--set {text!r}: expected KEY=VALUE, e.g. output.rate=5")
        found[key.strip()] = value.strip()
    return found
