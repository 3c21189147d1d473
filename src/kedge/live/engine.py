"""The estimators of a fleet: rows in, judged readings out. No I/O, and no clock of its own.

One thread owns an engine, as each estimator belongs to the thread of its first event.
"""

import hashlib
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import space, space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.log import SECOND
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.rows import NO_SENSOR
from kedge.live.places import Place, place_of
from kedge.live.status import Limits, Status, reasons_of
from kedge.live.watch import Judged, Watch

LAG = 0.5
"""s by which a reading may be late."""


class Member(NamedTuple):
    """A vehicle of a fleet; ``control`` is what holds at its start."""

    name: str
    filter: AbstractFilter
    rig: Rig
    control: Any


def rate_of(sensor: Installation) -> float:
    """How often it should read, in Hz."""
    return float(sensor.rate or sensor.sensor.nominal_rate)


def tells_position(sensor: Installation, state: Any) -> bool:
    """Whether a step of 1 m in the plane changes what it reads."""
    first = jnp.zeros((), int)

    def read(east: float, north: float) -> np.ndarray:
        shift = jnp.zeros(len(state.position)).at[:2].set(jnp.array([east, north]))
        expected = sensor.expect(state._replace(position=state.position + shift), first)
        return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(expected)])

    here = read(0.3, 0.2)
    return not all(
        np.allclose(here, read(*to), equal_nan=True) for to in ((1.3, 0.2), (0.3, 1.2))
    )


class Tracked:
    """One vehicle: its estimator, the watch over its sources, its status."""

    def __init__(self, member: Member, absolute: Sequence[bool], limits: Limits):
        self.member, self.absolute, self.limits = member, tuple(absolute), limits
        self.starts = 0
        self.begin(0.0)

    def begin(self, now: float) -> None:
        """Start afresh at ``now``, from the prior."""
        member, self.starts = self.member, self.starts + 1
        self.estimator = Estimator(
            member.filter, member.rig, start=now, control=member.control, lag=LAG, horizon=60.0
        )
        self.watches = [Watch(one.name, rate_of(one)) for one in member.rig.sensors]
        self.status = Status(now, self.limits)
        self.aligned, self.fused_at = False, now

    def push(self, rows: np.ndarray, received: float) -> tuple[np.ndarray, list[Judged]]:
        """Push rows that wait; the answers, and what became of each reading among them."""
        answers = self.estimator.push_many(rows)
        spaces = [space_of(one.sensor.measures) for one in self.member.rig.sensors]
        judged = []
        for place in np.flatnonzero(rows["sensor"] != NO_SENSOR):
            row, answer = rows[place], answers[place]
            sensor = int(row["sensor"])
            size = spaces[sensor].size
            residual = answer["residual"][:size]
            value = row["measurement"][:size]
            if any(chart.size != math.prod(chart.shape) for chart in spaces[sensor].charts):
                value = residual  # an attitude: shown as the turn from what was expected
            one = Judged(
                sensor, int(row["target"]), received, int(row["time"]) / SECOND,
                Verdict(int(answer["verdict"])), float(answer["nis"]), int(answer["dof"]),
                float(answer["threshold"]), value, residual, answer["std"][:size],
            )  # fmt: skip
            self.watches[sensor].saw(one)
            if one.verdict == Verdict.FUSED and self.absolute[sensor]:
                self.fused_at = received
            judged.append(one)
        return answers, judged

    def look(self, now: float) -> tuple[Place, Any, dict[str, Any] | None]:
        """Its place and belief at ``now``, and the change of its status if there is one."""
        belief = self.estimator.peek(max(now, self.estimator.time))
        place = place_of(belief)
        self.aligned = self.aligned or place.major < self.limits.aligned
        self.sources = [watch.summary(now) for watch in self.watches]
        reasons = reasons_of(
            self.sources, self.absolute, place.major, self.aligned,
            now - self.fused_at, self.limits,
        )  # fmt: skip
        return place, belief, self.status.update(reasons, now)

    def detail(self, belief: Any) -> dict[str, Any]:
        """What the page shows of it when it is selected."""
        labels = space(belief.mean).labels
        sigma = np.sqrt(np.maximum(np.diagonal(belief.cov), 0.0))
        zero = type(belief.mean)(*(np.zeros_like(leaf) for leaf in belief.mean))
        if hasattr(zero, "attitude"):
            zero = zero._replace(attitude=np.array([1.0, 0.0, 0.0, 0.0]))
        state = space(belief.mean).boxminus(belief.mean, zero)
        return {
            "status": self.status.value,
            "filter": type(self.member.filter).__name__.lower(),
            "since": self.status.since,
            "last": self.status.last,
            "reasons": self.status.reasons,
            "sources": self.sources,
            "resets": {"reset": self.starts - 1, "at": None, "delta": 0.0},
            "fields": list(labels),
            "sigma": [float(number) for number in sigma],
            "state": [float(number) for number in np.asarray(state)],
            "shadows": [],
        }


class Engine:
    """All vehicles of a fleet."""

    def __init__(self, members: Sequence[Member], limits: Limits | None = None):
        limits, known = limits or Limits(), {}
        for member in members:
            if id(member.rig) not in known:
                start = member.rig.prior.mean
                known[id(member.rig)] = [tells_position(s, start) for s in member.rig.sensors]
        self.vehicles = [Tracked(m, known[id(m.rig)], limits) for m in members]
        self._digest = hashlib.sha256()

    @property
    def digest(self) -> str:
        """Of all verdicts and estimates so far: equal for the same rows in the same turns."""
        return self._digest.hexdigest()

    def push(self, number: int, rows: np.ndarray, received: float) -> list[Judged]:
        """Rows that wait for one vehicle, as ``Estimator.rows`` makes them."""
        if not len(rows):
            return []
        answers, judged = self.vehicles[number].push(rows, received)
        moments: Any = answers["moments"]
        for column in (answers["verdict"], *(moments[name] for name in moments.dtype.names)):
            self._digest.update(np.ascontiguousarray(column).tobytes())
        return judged
