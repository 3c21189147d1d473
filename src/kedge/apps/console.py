"""What commands say: data on standard output, progress and errors on standard error."""

import contextlib
import json
import re
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

    known = {
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


REQUIREMENT = re.compile(r"^(\S+?)\s*(<=|>=)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)$")


def parse_requirements(conditions: Sequence[str]) -> list[tuple[str, str, float]]:
    """Conditions such as ``extended.rmse.position<=0.25`` as name, relation and bound.

    Raises:
        ConfigError: a condition cannot be understood.
    """
    found = []
    for condition in conditions:
        parts = REQUIREMENT.match(condition)
        if parts is None:
            raise ConfigError(
                f"--require {condition!r}: expected SCORE<=NUMBER or SCORE>=NUMBER, "
                "e.g. extended.rmse.position<=0.25"
            )
        name, relation, text = parts.groups()
        found.append((name, relation, float(text)))
    return found


def check_requirements(
    conditions: Conditions,
    filters: Sequence[str],
    scores: Sequence[str] | None = None,
) -> None:
    """Refuse what cannot be required, before anything runs.

    Raises:
        ConfigError: a condition is on a filter that is not to run, or there is no such score.
    """
    for name, *_ in conditions:
        if not any(name.startswith(f"{filter}.") for filter in filters):
            given = name if "." not in name else name[: name.index(".")]
            raise ConfigError(
                f"--require {name}: {unknown('filter in this run', given, list(filters))}"
            )
        if scores is not None and name not in scores:
            raise ConfigError(f"--require: {unknown('score', name, list(scores))}")


def require(filters: Mapping[str, Any], conditions: Conditions) -> None:
    """Check conditions against the scores.

    Raises:
        ConfigError: there is no such score.
        ThresholdMissed: a condition does not hold.
    """
    from kedge.formats.results import flatten

    scores = {k: v for k, v in flatten(filters) if isinstance(v, (int, float))}
    for name, relation, bound in conditions:
        if name not in scores:
            raise ConfigError(f"--require: {unknown('score', name, list(scores))}")
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
    """Print what a command found and where it is; then see that it is good enough.

    Raises:
        ThresholdMissed: a condition does not hold.
    """
    if as_json:
        print_json(summary)
    else:
        show(summary)
        if out is not None:
            shown = "report.html" if (out / "report.html").exists() else "summary.json"
            print(f"\nresults: {out / shown}")
    require(summary["filters"], conditions)
