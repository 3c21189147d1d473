"""What commands say: data on standard output, progress and errors on standard error."""

import contextlib
import json
import re
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from kedge.core.errors import ConfigError, KedgeError
from kedge.core.registry import unknown

Conditions = Sequence[tuple[str, str, float]]
"""Name of a score, relation, bound."""


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
    """Machine-readable output."""
    from kedge.formats.results import plain

    print(json.dumps(plain(value), indent=2, allow_nan=False))


def print_filters(filters: Mapping[str, Mapping[str, Any]]) -> None:
    """The table of filters, digits only as far as they say something."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    columns = _columns(filters)
    table.add_column("filter")
    for title in columns:
        table.add_column(title, justify="right")
    for name, scores in filters.items():
        table.add_row(name, *(show(scores) for show in columns.values()))
    # A pipe has no width; a table squeezed into 80 columns would lose its numbers.
    Console(width=None if sys.stdout.isatty() else 140, highlight=False).print(table)
    if not any("rmse" in scores for scores in filters.values()):
        print()
        print_sensors(filters)


def print_sensors(filters: Mapping[str, Mapping[str, Any]]) -> None:
    """The table of sensors by filter: what was used of each, and whether NIS is right."""
    from rich.console import Console
    from rich.table import Table

    from kedge.reports.findings import refusals
    from kedge.reports.style import is_baseline, is_smoother

    table = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("filter", "sensor"):
        table.add_column(title)
    for title in ("readings", "fused", "NIS", "right is"):
        table.add_column(title, justify="right")
    table.add_column("refused")
    for name, scores in filters.items():
        if is_baseline(name) or is_smoother(name):
            continue
        for sensor, entry in scores["sensors"].items():
            nis = [f"{entry[key]:.3g}" for key in ("nis", "nis_dof") if key in entry]
            used = f"{entry['fused']:.1%}" if "fused" in entry else "-"
            refused = refusals(entry["verdicts"])
            table.add_row(name, sensor, str(entry["readings"]), used, *(nis or "--"), refused)
    Console(width=None if sys.stdout.isatty() else 140, highlight=False).print(table)


def _columns(filters: Mapping[str, Mapping[str, Any]]) -> dict[str, Callable[[Any], str]]:
    def pick(*path: str, form: str = ".3g", scale: float = 1.0) -> Callable[[Any], str]:
        def show(scores: Any) -> str:
            for key in path:
                scores = scores.get(key, {}) if isinstance(scores, Mapping) else {}
            return format(scores * scale, form) if isinstance(scores, (int, float)) else "-"

        return show

    def interval(scores: Any) -> str:
        ends = scores.get("rmse_ci", {}).get("position")
        return f"[{ends[0]:.2g}, {ends[1]:.2g}]" if ends else "-"

    judged = any("rmse" in row for row in filters.values())
    believed = {} if judged else {
        "position 1-sigma m": pick("std", "position"),
        "heading 1-sigma deg": pick("std", "heading", scale=57.29577951308232),
    }  # fmt: skip
    known = believed | {
        "position m": pick("rmse", "position"),
        "95 % interval": interval,
        "in plan m": pick("rmse", "horizontal"),
        "heading deg": pick("rmse", "heading", scale=57.29577951308232),
        "velocity m/s": pick("rmse", "velocity"),
        "x baseline": pick("ratio_to_baseline"),
        "NEES/dof": _nees,
        "in 95 % bound": pick("coverage_95", "position", form=".0%"),
        "final error": _final,
        "us/event": pick("microseconds_per_event", form=".1f"),
    }
    rows = list(filters.values())
    return {t: show for t, show in known.items() if any(show(row) != "-" for row in rows)}


def _nees(scores: Mapping[str, Any]) -> str:
    dof = scores.get("nees_dof")
    return f"{scores['nees'] / dof:.3g}" if dof else "-"


def _final(scores: Mapping[str, Any]) -> str:
    driven = scores.get("distance")
    return f"{scores['final_error'] / driven:.2%} of path" if driven else "-"


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


def require(
    filters: Mapping[str, Any], conditions: Conditions, warnings: Sequence[str] = ()
) -> None:
    """Check conditions against the scores, and against the number of warnings.

    Raises:
        ConfigError: there is no such score.
        ThresholdMissed: a condition does not hold.
    """
    from kedge.formats.results import flatten
    from kedge.reports.style import is_baseline

    scores = {k: v for k, v in flatten(filters) if isinstance(v, (int, float))}
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
    summary: dict[str, Any],
    out: Path | None,
    conditions: Conditions,
    as_json: bool,
    show: Callable[[dict[str, Any]], None] = lambda summary: print_filters(summary["filters"]),
) -> None:
    """Print what a command computed, where it is, and its warnings; then what is required.

    Raises:
        ThresholdMissed: a condition does not hold.
    """
    if as_json:
        print_json(summary)
    else:
        show(summary)
        if out is not None:
            shown = "report.html" if (out / "report.html").exists() else "summary.json"
            print(f"\nresults: {out / shown}", flush=True)
    for text in summary["warnings"]:
        print(f"kedge: warning: {text}", file=sys.stderr)
    require(summary["filters"], conditions, summary["warnings"])
