"""What is known of one source from its last seconds: rate, jitter, refusals, NIS."""

from collections import Counter, deque
from typing import Any, NamedTuple

import numpy as np

from kedge.core.verdicts import Verdict
from kedge.evaluation.consistency import chi_square_bound

WINDOW = 5.0
"""s over which a source is judged, or four periods of it if that is longer."""


class Judged(NamedTuple):
    """One reading and what became of it; times in s, that of receipt by the service's clock."""

    sensor: int
    target: int
    received: float
    stamp: float
    verdict: Verdict
    nis: float
    dof: int
    threshold: float
    value: np.ndarray
    residual: np.ndarray
    std: np.ndarray


class Watch:
    """The last seconds of one source; ``rate`` is what it should send, in Hz."""

    def __init__(self, name: str, rate: float):
        self.name, self.rate = name, rate
        self.span = max(WINDOW, 4 / rate)
        self.total: Counter[str] = Counter()
        self.last: Verdict | None = None
        self.received: float | None = None
        self.offset = 0.0
        """s by which its stamps are behind the receive clock."""
        self._recent: deque[Judged] = deque()

    def saw(self, reading: Judged) -> None:
        """Remember a reading."""
        self._recent.append(reading)
        self.last, self.received = reading.verdict, reading.received
        self.offset = reading.received - reading.stamp
        self.total["fused" if reading.verdict == Verdict.FUSED else "refused"] += 1

    def summary(self, now: float) -> dict[str, Any]:
        """Its window at ``now``, as the page shows it; None where nothing is known."""
        while self._recent and self._recent[0].received < now - self.span:
            self._recent.popleft()
        recent = list(self._recent)
        gaps = np.diff([one.stamp for one in recent])
        judged = [one for one in recent if np.isfinite(one.nis) and one.dof > 0]
        dof = sum(one.dof for one in judged)
        bound = [chi_square_bound(dof, p) / dof if dof else None for p in (0.025, 0.975)]
        refused = sum(one.verdict != Verdict.FUSED for one in recent)
        return {
            "name": self.name,
            "rate": len(recent) / self.span,
            "nominal": self.rate,
            "span": self.span,
            "jitter": float(np.std(gaps)) if len(gaps) > 1 else 0.0,
            "offset": self.offset,
            "drift": None,
            "silent": None if self.received is None else now - self.received,
            "nis": sum(one.nis for one in judged) / dof if dof else None,
            "low": bound[0],
            "high": bound[1],
            "refused": refused / len(recent) if recent else 0.0,
            "count": len(recent),
            "last": None if self.last is None else self.last.name,
            "total": {name: self.total[name] for name in ("fused", "refused")},
        }
