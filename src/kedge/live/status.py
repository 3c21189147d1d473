"""Does a vehicle know where it is? A status with reasons, by the clock of receipt."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

ORDER = ("OK", "ALIGNING", "DEGRADED", "DEAD_RECKONING", "LOST")
"""From good to bad."""


@dataclasses.dataclass(frozen=True)
class Limits:
    """Where a status changes."""

    aligned: float = 0.6
    """m of the 95 % bound below which a vehicle that starts knows where it is."""
    lost: float = 3.0
    """m of the 95 % bound above which it does not."""
    clock: float = 0.5
    """s between a source's stamps and the clock of receipt."""
    refused: float = 0.25
    """Share of a source's readings."""
    contradicted: float = 0.9
    """Share refused of a source of positions, of which none was fused for ``contradiction``."""
    contradiction: float = 4.0  # s
    silence: float = 2.0
    """s without a reading, or three periods of the source if that is longer."""
    stale: float = 2.0
    """s without a position that was fused, or three periods."""
    worse: float = 0.3
    """s for which a worse status must hold before it is shown."""
    better: float = 1.0
    """s for which a better one must."""


class Reason(NamedTuple):
    """Why a status is not OK."""

    level: str
    key: str
    text: str


def reasons_of(
    sources: Sequence[dict[str, Any]],
    absolute: Sequence[bool],
    deviation: float,
    aligned: bool,
    since_fused: float,
    limits: Limits,
) -> list[Reason]:
    """Reasons, the worst first.

    ``deviation`` is the 95 % bound in m, ``since_fused`` the s since a position was fused.
    """
    reasons, lost = [], False
    for source, tells_position in zip(sources, absolute, strict=True):
        name, period = source["name"], 1 / source["nominal"]
        allowed = max(limits.silence, 3 * period)
        silent = source["silent"]
        if silent is not None and silent > allowed:
            text = f"{name} silent for {silent:.1f} s (allowed {allowed:.1f} s)"
            reasons.append(Reason("DEGRADED", f"silent {name}", text))
        elif abs(source["offset"]) > limits.clock:
            text = (
                f"{name} stamps {source['offset']:+.2f} s behind (limit {limits.clock:.2f} s)"
            )
            reasons.append(Reason("DEGRADED", f"clock {name}", text))
        elif source["count"] >= 4 and source["refused"] > limits.refused:
            share = f"{100 * source['refused']:.0f} % refused in {source['span']:.0f} s"
            text = f"{name}: {share} (limit {100 * limits.refused:.0f} %)"
            reasons.append(Reason("DEGRADED", f"refused {name}", text))
            refuted = tells_position and source["refused"] > limits.contradicted
            lost = lost or (refuted and since_fused > limits.contradiction)
    if not aligned:
        text = f"deviation {deviation:.2f} m (needs {limits.aligned:.2f} m)"
        reasons.append(Reason("ALIGNING", "aligning", text))
        return sorted(reasons, key=_badness)
    periods = [3 / s["nominal"] for s, a in zip(sources, absolute, strict=True) if a]
    stale = max([limits.stale, *periods])
    if not periods:
        text = "no source tells its position"
        reasons.append(Reason("DEAD_RECKONING", "no position", text))
    elif since_fused > stale:
        text = f"no position fused for {since_fused:.1f} s (limit {stale:.1f} s)"
        reasons.append(Reason("DEAD_RECKONING", "stale", text))
    if lost:
        text = f"positions contradict the estimate for {since_fused:.1f} s"
        text += f" (limit {limits.contradiction:.1f} s)"
        reasons.append(Reason("LOST", "contradicted", text))
    if deviation > limits.lost:
        text = f"deviation {deviation:.1f} m (limit {limits.lost:.1f} m)"
        reasons.append(Reason("LOST", "deviation", text))
    return sorted(reasons, key=_badness)


def _badness(reason: Reason) -> int:
    return -ORDER.index(reason.level)


class Status:
    """A status, quick to worsen and slow to recover, and since when each reason holds."""

    def __init__(self, now: float, limits: Limits):
        self.value, self.since, self._limits = "ALIGNING", now, limits
        self.last: dict[str, Any] | None = None
        self.reasons: list[dict[str, Any]] = []
        self._starts: dict[str, float] = {}
        self._pending: tuple[str, float] | None = None

    def update(self, reasons: Sequence[Reason], now: float) -> dict[str, Any] | None:
        """Take the reasons that hold at ``now``; the change, if there is one."""
        self._starts = {one.key: self._starts.get(one.key, now) for one in reasons}
        self.reasons = [{**r._asdict(), "since": self._starts[r.key]} for r in reasons]
        wanted = reasons[0].level if reasons else "OK"
        if wanted == self.value:
            self._pending = None
            return None
        if self._pending is None or self._pending[0] != wanted:
            self._pending = wanted, now
        worse = ORDER.index(wanted) > ORDER.index(self.value)
        wait = self._limits.worse if worse else self._limits.better
        if now - self._pending[1] < wait - 1e-9:
            return None
        text = reasons[0].text if reasons else "all sources agree"
        self.last = {"at": now, "from": self.value, "to": wanted, "text": text}
        self.value, self.since, self._pending = wanted, now, None
        return self.last
