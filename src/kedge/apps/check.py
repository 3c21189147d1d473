"""The work behind ``kedge check``: is a rig honest on a log, without truth?"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.random as jr

from kedge.apps.console import (
    check_requirements,
    console_progress,
    parse_requirements,
    print_json,
    print_table,
    require,
)
from kedge.apps.summaries import facts_of, provenance
from kedge.apps.workflow import load
from kedge.checking.advice import findings, quantities, sensor_checks, undetermined
from kedge.checking.check import Checked, check
from kedge.checking.planted import PLANTED, planted
from kedge.checking.summary import CheckSummary
from kedge.config.filters import build_filter
from kedge.config.problem import Problem
from kedge.estimation.compilation_cache import use_compilation_cache
from kedge.evaluation.record import record
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.formats.results import as_toml, digest, write_summary
from kedge.formats.results_folder import results_folder
from kedge.reports.check_report import HEAD, CheckContent, headline, rows, spans, write_check


def check_log(
    rig: str,
    log: str,
    out: Path | None,
    filter: str | None,
    until: float | None,
    changes: Sequence[str] | None,
    required: Sequence[str],
    report: bool,
    as_json: bool,
) -> None:
    """Check, print, and compare with what is required.

    Raises:
        KedgeError: rig or log cannot be used.
        ThresholdMissed: a condition does not hold.
    """
    conditions = parse_requirements(required)
    problem = load(rig, log, "auto", until, changes)
    check_requirements(conditions, list(problem.rig.names))
    summary = execute(problem, filter or problem.filter, out, report)
    if as_json:
        print_json(summary)
    else:
        print_check(summary)
        if out is not None:
            print(f"\nresults: {out / ('report.html' if report else 'summary.json')}")
    require(summary.filters, conditions, summary.about.warnings)


def self_test_table(logs: int, seed: int, as_json: bool) -> None:
    """Print which faults that are planted on purpose are detected, and what else is alarmed."""
    table = self_test(logs, seed)
    if as_json:
        print_json([dict(zip(SELF_TEST_HEAD, row, strict=True)) for row in table])
    else:
        print_table(SELF_TEST_HEAD, table)


def execute(problem: Problem, filter: str, out: Path | None, report: bool) -> CheckSummary:
    """Check a rig on a log; write the folder of results if there is to be one.

    Raises:
        KedgeError: the rig cannot be run on the log, or the folder cannot be written.
    """
    use_compilation_cache()
    if out is None:
        with console_progress() as progress:
            return _summary(problem, _checked(problem, filter, progress))
    with results_folder(out, "check") as folder, console_progress() as progress:
        summary = _summary(problem, _checked(problem, filter, progress))
        write_summary(folder / "summary.json", record(summary))
        if report:
            progress("drawing the report")
            facts = facts_of(summary.about)
            write_check(folder, CheckContent(summary, as_toml(problem.config), facts))
    return summary


def _checked(problem: Problem, filter: str, progress: Any) -> Checked:
    return check(build_filter(filter), problem.rig, problem.recording, progress)


def _summary(problem: Problem, checked: Checked) -> CheckSummary:
    names = problem.target_names
    wrong = findings(checked, names)
    sensors = sensor_checks(checked, names)
    about = provenance(
        "check",
        problem.title,
        problem.config,
        {"inputs": problem.inputs_digest, "result": digest(record(sensors))},
        notes=tuple(problem.notes),
        warnings=[f"{finding.text}; {finding.advice}" for finding in wrong],
    )
    return CheckSummary(
        about, sensors, tuple(wrong), quantities(checked), tuple(undetermined(checked))
    )


def print_check(summary: CheckSummary) -> None:
    """The table of sensors, and what the log could not tell."""
    print_table(HEAD, rows(summary), "lrrrrrrrrrl")
    print(f"\n{headline(summary)}")
    for finding in summary.findings:
        print(f"* {finding.text}\n    {finding.advice}")
    for name, entry in summary.filters.items():
        if entry.unfit:
            print(f"* {name}: its model does not hold {spans(entry.unfit)}")
    if summary.undetermined:
        print("\nThis log could not determine")
        for line in summary.undetermined:
            print(f"* {line}")


def self_test(
    logs: int, seed: int = 0, faults: Sequence[str | None] = (None, *PLANTED)
) -> list[list[str]]:
    """Plant each fault in so many simulated logs: fault, detected, other alarms, all logs."""
    use_compilation_cache()
    table = []
    with console_progress() as progress:
        for fault in faults:
            detected = others = 0
            for number in range(logs):
                progress(f"{fault or 'nothing wrong'}: log {number + 1} of {logs}")
                recording, rig = planted(fault, jr.key(seed + number))
                wrong = findings(check(ExtendedKalman(), rig, recording), {})
                meant = [f for f in wrong if fault and (f.kind, f.subject) == PLANTED[fault]]
                detected += bool(meant)
                others += len(wrong) > len(meant)
            hits = "-" if fault is None else f"{detected}"
            table.append([fault or "nothing wrong", hits, f"{others}", f"{logs}"])
    return table


SELF_TEST_HEAD = ("planted", "detected", "logs with another alarm", "logs")
