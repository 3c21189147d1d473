"""What to ask of a log whose numbers are possible but odd: units, and clocks."""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float, Int64

from kedge.estimation.log import SECOND
from kedge.formats.logs import TargetMap
from kedge.formats.tables import Table

FARTHER = 50.0
"""Times the width of a map beyond which a range is hardly one."""
TURNS = 4 * np.pi  # rad; a heading that counts turns may well be above one
BRISK = 2 * np.pi  # rad/s
LATE = 1.0  # s
ALIKE = 0.3
"""Share by which a source may be late in other ways at its end than at its beginning."""


def odd_ranges(name: str, ranges: Float[np.ndarray, " n"], targets: TargetMap) -> Iterator[str]:
    """Ranges that are far longer than the map is wide."""
    places = [v for c, v in targets.columns.items() if c.startswith("position_")]
    wide = float(np.linalg.norm([np.ptp(values) for values in places])) if places else 0.0
    known = ranges[np.isfinite(ranges)]
    if wide > 0 and len(known) and (usual := float(np.median(known))) > FARTHER * wide:
        yield (
            f"{name}: ranges of {usual:.4g} m in the median, but the map is {wide:.4g} m wide; "
            "are they in mm or cm?"
        )


def odd_angles(name: str, columns: Mapping[str, Float[np.ndarray, " n"]]) -> Iterator[str]:
    """Headings and yaw rates that look like degrees."""
    for part, values in columns.items():
        known = np.abs(values[np.isfinite(values)])
        if not len(known):
            continue
        if part in ("heading", "bearing") and (largest := float(known.max())) > TURNS:
            yield f"{name}: {part} goes up to {largest:.4g} rad; is it in deg?"
        if part == "yaw_rate" and (share := float(np.mean(known > BRISK))) > 0.01:
            yield (
                f"{name}: turns faster than once a second in {100 * share:.0f} % of the log; "
                "is the yaw rate in deg/s?"
            )


def odd_log(
    control: Int64[np.ndarray, " n"],
    sources: Mapping[str, Int64[np.ndarray, " k"]],
    truth: Table | None,
) -> Iterator[str]:
    """What to ask of all sources together: clocks, units of time, a truth of zeros."""
    yield from odd_clocks(control, sources)
    reference = {} if truth is None else {"truth": truth.stamps}
    yield from odd_spans({"control": control, **sources, **reference})
    places = [v for c, v in truth.columns.items() if c.startswith("position_")] if truth else []
    if places and len(places[0]) > 1 and not np.any(places):
        yield "truth: all its positions are 0; is it one that nobody filled in?"


def odd_spans(sources: Mapping[str, Int64[np.ndarray, " n"]]) -> Iterator[str]:
    """Sources that last a thousand times as long as the others do, or a thousandth."""
    spans = {n: float(np.ptp(s)) / SECOND for n, s in sources.items() if len(s) > 2}
    spans = {name: span for name, span in spans.items() if span > 0}
    for name, span in spans.items():
        others = [other for another, other in spans.items() if another != name]
        if not others or (len(others) == 1 and name == "control"):
            continue  # of two, the other one is asked
        nearest = min(others, key=lambda other: abs(np.log(span / other)))
        powers = np.log10(span / nearest)
        if abs(powers) > 2 and abs(powers - 3 * round(powers / 3)) < 0.3:
            yield (
                f"{name}: lasts {span:.4g} s, the others {nearest:.4g} s; are its stamps of "
                "another unit (time_unit)?"
            )


def odd_clocks(
    control: Int64[np.ndarray, " n"], sources: Mapping[str, Int64[np.ndarray, " k"]]
) -> Iterator[str]:
    """Sources that begin and end earlier, or later, than the control, by the same seconds."""
    for name, stamps in sources.items():
        if len(control) < 2 or len(stamps) < 2:
            continue
        begin, end = (float(stamps[at] - control[at]) / SECOND for at in (0, -1))
        usual = float(np.median(np.diff(stamps))) / SECOND
        offset = min(abs(begin), abs(end))
        if offset > max(LATE, 3 * usual) and abs(begin - end) < ALIKE * offset:
            when = f"{offset:.3g} s {'after' if begin > 0 else 'before'}"
            yield (
                f"{name}: begins and ends {when} the control does; do their clocks differ? "
                "(latency, or a topic's offset, mends it)"
            )
