"""What to ask of a log whose numbers are possible but odd: units, and clocks."""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float, Int64

from kedge.estimation.log import SECOND
from kedge.formats.logs import TargetMap

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
