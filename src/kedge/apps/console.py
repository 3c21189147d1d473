"""What commands say: data on standard output, progress and errors on standard error."""

import contextlib
import itertools
import json
import math
import os
import re
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

from kedge.core.errors import ConfigError, KedgeError
from kedge.core.registry import unknown

if TYPE_CHECKING:
    from kedge.evaluation.scores import FilterScores, LogSummary, Provenance
else:
    FilterScores = LogSummary = Provenance = Any

Conditions = Sequence[tuple[str, str, float]]
"""Name of a score, relation, bound."""


@runtime_checkable
class Summary(Protocol):
    """What each command leaves as ``summary.json``."""

    @property
    def about(self) -> Provenance: ...

    @property
    def filters(self) -> Mapping[str, Any]: ...


S = TypeVar("S", bound=Summary)


class ThresholdMissed(KedgeError):
    """A threshold that the user asked for was missed: exit code 3."""


class Interrupted(KedgeError):
    """Ctrl-C, with what was kept: exit code 130."""


@contextlib.contextmanager
def interruptions() -> Iterator[None]:
    """A request to end (SIGTERM) is a Ctrl-C, and either is said.

    Raises:
        Interrupted: by one of them.
    """

    def interrupt(number: int, frame: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as ended:
        # Typer makes the first into the second.
        if isinstance(ended, SystemExit) and ended.code != 130:
            raise
        raise Interrupted("nothing new is kept") from None
    finally:
        signal.signal(signal.SIGTERM, before)


def command_line() -> list[str]:
    """The arguments as they were typed: UTF-8, whatever the locale takes them for."""
    return [os.fsencode(argument).decode("utf-8", "replace") for argument in sys.argv[1:]]


def printer(width: int | None = 140) -> Any:
    """A Rich console on standard output; ``width`` columns wide where that is no terminal."""
    from rich.console import Console

    class Printer(Console):
        def on_broken_pipe(self) -> None:
            # Rich would end with 1 when the reader (`| head`) has seen enough.
            raise BrokenPipeError

    return Printer(width=None if sys.stdout.isatty() else width, highlight=False)


@contextlib.contextmanager
def console_progress(quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Give a function that says what is being done; a spinner on a terminal, else lines."""
    if quiet:
        yield lambda text: None
    elif sys.stderr.isatty():
        from rich.console import Console

        with Console(stderr=True).status("starting") as status:
            yield status.update
    else:
        begin = time.perf_counter()

        def line(text: str) -> None:
            print(f"[{time.perf_counter() - begin:5.1f} s] {text}", file=sys.stderr, flush=True)

        yield line


@contextlib.contextmanager
def plain_warnings() -> Iterator[None]:
    """Show warnings that are meant for users like errors: one line, without a line of code."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        if category is UserWarning:
            print(f"kedge: warning: {message}", file=sys.stderr)
        else:
            usual(message, category, *rest, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual


def print_json(value: Any) -> None:
    """Machine-readable output, of a summary or of what JSON takes as it is."""
    from kedge.evaluation.record import record
    from kedge.formats.results import plain

    print(json.dumps(plain(record(value)), indent=2, allow_nan=False))


def print_filters(summary: LogSummary) -> None:
    """The table of filters, digits only as far as they are known; without truth, of sensors."""
    filters = summary.filters
    columns = _columns(filters)
    rows = [[name, *(show(row) for show in columns.values())] for name, row in filters.items()]
    print_table(["filter", *columns], rows)
    if not any(row.rmse for row in filters.values()):
        print()
        print_sensors(filters)


def print_sensors(filters: Mapping[str, FilterScores]) -> None:
    """The table of sensors by filter: what was used of each, and whether NIS is right."""
    from kedge.reports.findings import refusals
    from kedge.reports.style import is_baseline, is_smoother

    head = ["filter", "sensor", "readings", "fused", "NIS", "right is", "refused"]
    rows = [
        [name, sensor, str(entry.readings), _shown(entry.fused, ".1%"), _shown(entry.nis),
         _shown(entry.nis_dof), refusals(entry.verdicts)]
        for name, scores in filters.items()
        if not is_baseline(name) and not is_smoother(name)
        for sensor, entry in scores.sensors.items()
    ]  # fmt: skip
    print_table(head, rows, "llrrrrl")


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]], sides: str = "l") -> None:
    """A table; ``sides`` has an l or r for each column, r for those it does not have."""
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    for title, side in itertools.zip_longest(head, sides, fillvalue="r"):
        table.add_column(title, justify="left" if side == "l" else "right")
    for row in rows:
        table.add_row(*row)
    # A pipe has no width; a table squeezed into 80 columns would lose its numbers.
    printer().print(table)


def _columns(filters: Mapping[str, FilterScores]) -> dict[str, Callable[[FilterScores], str]]:
    """What there is to show of the filters, by title."""

    def error(name: str, scale: float = 1.0) -> Callable[[FilterScores], str]:
        return lambda row: _shown(row.rmse[name].value * scale) if name in row.rmse else "-"

    def believed(name: str, scale: float = 1.0) -> Callable[[FilterScores], str]:
        return lambda row: _shown(row.std[name] * scale) if name in row.std else "-"

    def interval(row: FilterScores) -> str:
        position = row.rmse.get("position")
        return f"[{position.lower:.2g}, {position.upper:.2g}]" if position else "-"

    degrees = math.degrees(1.0)
    columns = {
        "position m": error("position"),
        "95 % interval": interval,
        "in plan m": error("horizontal"),
        "heading deg": error("heading", degrees),
        "velocity m/s": error("velocity"),
        "x baseline": lambda row: _shown(row.ratio_to_baseline),
        "NEES/dof": _nees,
        "in 95 % bound": lambda row: _shown(row.coverage_95.get("position"), ".0%"),
        "final error": _final,
        "us/event": lambda row: _shown(row.microseconds_per_event, ".1f"),
    }
    if not any(row.rmse for row in filters.values()):
        columns = {
            "position 1-sigma m": believed("position"),
            "heading 1-sigma deg": believed("heading", degrees),
        } | columns
    rows = list(filters.values())
    return {t: show for t, show in columns.items() if any(show(row) != "-" for row in rows)}


def _nees(scores: FilterScores) -> str:
    if scores.nees is None or not scores.nees_dof:
        return "-"
    return "singular" if math.isnan(scores.nees) else _shown(scores.nees / scores.nees_dof)


def _final(scores: FilterScores) -> str:
    share = scores.final_error_of_distance
    return "-" if share is None else f"{share:.2%} of path"


def _shown(value: float | None, form: str = ".3g") -> str:
    return "-" if value is None or not math.isfinite(value) else format(value, form)


WARNINGS = "warnings"
"""What is required of their number."""
REQUIREMENT = re.compile(r"^(\S+?)\s*(<=|>=)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)$")


def parse_requirements(conditions: Sequence[str]) -> list[tuple[str, str, float]]:
    """Conditions such as ``extended.rmse.position<=0.25`` as name, relation and bound.

    ``camera.fused>=0.9`` is on a sensor, of every filter but dead reckoning; ``no warnings``
    is ``warnings<=0``: the length of the summary's list.

    Raises:
        ConfigError: a condition cannot be understood.
    """
    found = []
    for condition in conditions:
        plain = "warnings<=0" if condition.strip() == "no warnings" else condition
        parts = REQUIREMENT.match(plain)
        if parts is None:
            raise ConfigError(
                f"--require {condition!r}: expected SCORE<=NUMBER or SCORE>=NUMBER, "
                "e.g. extended.rmse.position<=0.25, or 'no warnings'"
            )
        name, relation, text = parts.groups()
        found.append((name, relation, float(text)))
    return found


def check_requirements(
    conditions: Conditions,
    filters: Sequence[str],
    scores: Sequence[str] | None = None,
    sensors: Sequence[str] = (),
) -> None:
    """Refuse what cannot be required, before anything runs.

    Raises:
        ConfigError: a condition is on what is no filter of this run and no sensor, or there is
            no such score.
    """
    for name, *_ in conditions:
        if name == WARNINGS or name.partition(".")[0] in sensors:
            continue
        if not any(name.startswith(f"{filter}.") for filter in filters):
            given = name if "." not in name else name[: name.index(".")]
            raise ConfigError(
                f"--require {name}: {unknown('filter in this run', given, list(filters))}"
            )
        if scores is not None and name not in scores:
            raise ConfigError(f"--require: {unknown('score', name, list(scores))}")


def require(filters: Any, conditions: Conditions, warnings: Sequence[str] = ()) -> None:
    """Check conditions against the scores, and against the number of warnings.

    Raises:
        ConfigError: there is no such score.
        ThresholdMissed: a condition does not hold.
    """
    from kedge.evaluation.record import by_name
    from kedge.reports.style import is_baseline

    scores = {name: score.value for name, score in by_name(filters).items()}
    scores[WARNINGS] = len(warnings)
    for name, relation, bound in conditions:
        if name in scores:
            names = [name]
        else:  # SENSOR.SCORE: of every filter that takes readings in
            names = [
                key
                for filter in filters
                if not is_baseline(filter) and (key := f"{filter}.sensors.{name}") in scores
            ]
        if not names:
            raise ConfigError(f"--require: {unknown('score', name, list(scores))}")
        for name in names:
            value = float(scores[name])
            if not (value <= bound if relation == "<=" else value >= bound):
                raise ThresholdMissed(f"{name} is {value:.6g}, required {relation} {bound:g}")


def finish(
    summary: S,
    out: Path | None,
    conditions: Conditions,
    as_json: bool,
    show: Callable[[S], None],
) -> None:
    """Print what a command computed, where it is, and its warnings; then what is required.

    Raises:
        ThresholdMissed: a condition does not hold.
    """
    warnings = summary.about.warnings
    from kedge.reports.findings import UNTRUSTED

    # What makes the figures worthless stands before them.
    doubts = [text for text in warnings if UNTRUSTED in text]
    for text in doubts:
        print(f"kedge: warning: {text}", file=sys.stderr)
    if as_json:
        print_json(summary)
    else:
        show(summary)
        if out is not None:
            shown = "report.html" if (out / "report.html").exists() else "summary.json"
            print(f"\nresults: {out / shown}", flush=True)
    for text in warnings:
        if text not in doubts:
            print(f"kedge: warning: {text}", file=sys.stderr)
    require(summary.filters, conditions, warnings)
