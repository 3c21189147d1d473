"""The page of a check: what was found, sensor by sensor, and what the log could tell."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kedge.checking.summary import CheckSummary, SensorCheck
from kedge.reports import style
from kedge.reports.page import Front, Plate, write_page

HEAD = (
    "sensor", "rate, Hz", "jitter, ms", "longest gap, s", "off by, of claimed", "lag 1",
    "held 1 s", "5 s", "20 s", "for good", "verdict",
)  # fmt: skip


MOST_SPANS = 3


class CheckContent(NamedTuple):
    """What the page is made of."""

    summary: CheckSummary
    configuration: str
    facts: dict[str, str]


def headline(summary: CheckSummary) -> str:
    """The result in one sentence."""
    if not summary.findings:
        return "Nothing in this log contradicts the rig."
    count = len(summary.findings)
    if count == 1:
        return "One thing in the rig contradicts this log."
    return f"{count} things in the rig contradict this log."


def rows(summary: CheckSummary) -> list[list[str]]:
    """A row a sensor, as text."""
    return [[name, *_cells(entry)] for name, entry in summary.filters.items()]


def _cells(entry: SensorCheck) -> list[str]:
    def shown(value: float | None, form: str = ".2g") -> str:
        return "-" if value is None else format(value, form)

    stream = entry.stream
    covered = [
        f"{entry.coverage[key].inside:.0%}" if key in entry.coverage else "-"
        for key in ("1", "5", "20", "for good")
    ]
    return [
        shown(stream and stream.rate, ".3g"),
        shown(stream and 1000 * stream.jitter),
        shown(stream and stream.longest_gap),
        shown(entry.noise_ratio),
        shown(entry.lag_1),
        *covered,
        entry.verdict,
    ]


def spans(times: Sequence[tuple[float, float]]) -> str:
    """Stretches of time as text, the longest ones if they are many."""
    longest = sorted(times, key=lambda span: span[0] - span[1])[:MOST_SPANS]
    text = ", ".join(f"from {a:.1f} s to {b:.1f} s" for a, b in sorted(longest))
    others = len(times) - len(longest)
    return f"{text}, and in {others} shorter stretches" if others else text


def write_check(folder: Path, content: CheckContent) -> Path:
    """Write ``report.html`` with its figures.

    Raises:
        KedgeError: matplotlib or jinja2 is not installed.
    """
    summary = content.summary
    strip = [(name, f"{entry.readings} readings") for name, entry in summary.filters.items()]
    front = Front(
        "kedge · check", summary.about.title, headline(summary), strip,
        [f"{f.text}. {f.advice}." for f in summary.findings],
    )  # fmt: skip
    plate = Plate(
        "coverage",
        "coverage",
        "Readings that were held back: how many lie in the region that should hold 95 %.",
        draw_coverage(summary),
    )
    quantities = [
        [name, f"{q.value:.3g}", "-" if q.std is None else f"{2 * q.std:.2g}"]
        for name, q in summary.quantities.items()
    ]
    return write_page(
        folder, "check.html.j2", front, [plate], head=HEAD, rows=rows(summary),
        quantities=quantities, undetermined=summary.undetermined, facts=content.facts,
        unfit=[f"{name}: {spans(e.unfit)}" for name, e in summary.filters.items() if e.unfit],
        notes=summary.about.notes, configuration=content.configuration,
    )  # fmt: skip


@style.styled
def draw_coverage(summary: CheckSummary) -> Any:
    """Draw the share of readings inside their region, by how long they were held back."""
    ax = style.given(None, 2.6)
    keys = ("1", "5", "20", "for good")
    count = max(len(summary.filters), 1)
    for number, (name, entry) in enumerate(summary.filters.items()):
        at = [i for i, key in enumerate(keys) if key in entry.coverage]
        inside = [100 * entry.coverage[keys[i]].inside for i in at]
        shift = 0.3 * (number - (count - 1) / 2) / count
        ax.plot(np.array(at) + shift, inside, "o", ms=4, label=name)
    ax.axhline(95, color=style.color("muted"), lw=0.6)
    ax.set_xticks(range(len(keys)), [f"{k} s" if k[0].isdigit() else k for k in keys])
    ax.set_ylim(0, 105)
    ax.set_ylabel("inside (%)")
    ax.set_xlabel("held back for")
    ax.legend(loc="lower left")
    return ax.figure
