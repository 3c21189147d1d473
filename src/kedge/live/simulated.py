"""A simulated fleet: shipped scenarios, drawn once and driven again and again."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kedge.config.filters import build_filter
from kedge.config.scenarios import load_scenario
from kedge.core.errors import DataError
from kedge.estimation.log import SECOND
from kedge.estimation.online import Estimator
from kedge.estimation.replay import as_events
from kedge.estimation.rig import Rig
from kedge.live.engine import Engine, Member
from kedge.live.faults import Switched, with_fault
from kedge.live.frame import COLUMNS, LOCALIZED, TRUSTED, Frame
from kedge.live.places import heading_of
from kedge.live.status import ORDER
from kedge.live.watch import Judged
from kedge.simulation import record

STEP = 0.1
"""s of the stream between two frames."""
DETAILS_EVERY = 5  # frames


class Plan(NamedTuple):
    """A vehicle to simulate."""

    name: str
    scenario: str
    seed: int
    kind: str
    shape: str
    size: tuple[float, float]
    overrides: dict[str, str] = {}


_YARD = {
    "scenario.duration": "300.0",
    "vehicle.parameters.speed_noise": "0.1",
    "sensors.camera.rate": "5.0",
    "sensors.camera.gate": "0.001",
    "sensors.camera.parameters.range_std": "0.1",
    "sensors.camera.parameters.bearing_std": "0.005",
}
"""The yard for a while, with a camera that is as good as a laser scanner."""
_CARRIER = ("AGV, differential drive", "box", (1.6, 1.0))
_GATED = {"sensors.camera.gate": "0.001"}
FLEET = (
    Plan("carrier 1", "yard", 1, *_CARRIER, _YARD),
    Plan("carrier 2", "yard", 2, *_CARRIER, _YARD),
    Plan("shuttle", "omni-square", 3, "AGV, omnidirectional", "disc", (0.9, 0.9), _GATED),
    Plan("otter", "auv-survey", 4, "AUV, thruster driven", "hull", (1.9, 0.7)),
)  # fmt: skip


class Drive(NamedTuple):
    """What one vehicle sends from time 0 on, and where it really is."""

    plan: Plan
    member: Member
    rows: np.ndarray
    seconds: float
    truth: np.ndarray
    """x, y, heading at every step of the simulation."""
    truth_step: float
    std: np.ndarray
    """Of each sensor's components, at the start."""


def drive(plan: Plan) -> Drive:
    """Simulate a plan.

    Raises:
        KedgeError: there is no such scenario, or it does not go with the plan.
    """
    scenario = load_scenario(plan.scenario, plan.overrides).scenario
    recording, truth = record(scenario, jax.random.key(plan.seed))
    controls = jax.tree.map(np.asarray, recording.log.controls)
    first = jax.tree.map(lambda leaf: leaf[0], controls)
    member = Member(plan.name, build_filter("extended"), scenario.rig, first)
    maker = Estimator(member.filter, member.rig, control=first)
    rows = maker.rows(as_events(recording.log, maker.sensors))
    state = type(scenario.rig.prior.mean)
    fields = [
        state(**{name: leaf[i] for name, leaf in truth.fields.items()})
        for i in range(len(truth.time))
    ]
    path = np.array([[*one.position[:2], heading_of(one)] for one in fields])
    std = _std(scenario.rig, rows["measurement"].shape[1])
    return Drive(plan, member, rows, scenario.duration, path, scenario.dt, std)


def _std(rig: Rig, width: int) -> np.ndarray:
    std = np.zeros((len(rig.sensors), width))
    for row, sensor in zip(std, rig.sensors, strict=True):
        cov = np.asarray(sensor.noise_cov(rig.prior.mean, jnp.zeros((), int)))
        row[: len(cov)] = np.sqrt(np.diagonal(cov))
    return std


class Fleet:
    """Drives that go on together, the engine that follows them, and faults between the two."""

    def __init__(self, drives: Sequence[Drive]):
        self.drives, self.engine = list(drives), Engine([one.member for one in drives])
        self.steps, self.faults = 0, list[Switched]()
        self._begun = [0.0] * len(self.drives)

    @property
    def now(self) -> float:
        """S of the stream: its clock of receipt."""
        return self.steps * STEP

    def ready(self) -> None:
        """Compile all that can come."""
        for vehicle in self.engine.vehicles:
            vehicle.estimator.ready()

    def inject(self, vehicle: Any, kind: Any, source: Any = None, seconds: Any = None) -> None:
        """Switch a fault on.

        Raises:
            DataError: there is no such vehicle, fault or source.
        """
        if type(vehicle) is not int or not 0 <= vehicle < len(self.drives):
            last = len(self.drives) - 1
            raise DataError(
                f"fault: vehicle is {vehicle!r}, expected a number from 0 to {last}"
            )
        sources = len(self.drives[vehicle].member.rig.sensors)
        number = len(self.faults)
        fault = Switched.checked(number, kind, vehicle, source, sources, self.now, seconds)
        self.faults.append(fault)

    def stop(self, number: Any) -> None:
        """Switch a fault off.

        Raises:
            DataError: there is none of that number.
        """
        if type(number) is not int or not 0 <= number < len(self.faults):
            raise DataError(f"fault: stop is {number!r}, expected the id of a fault")
        fault = self.faults[number]
        self.faults[number] = fault._replace(end=min(fault.end, self.now))

    def step(self) -> Frame:
        """Go on by one step: what there is to show then."""
        before, self.steps = self.now, self.steps + 1
        now = self.now
        readings: list[tuple[int, Judged]] = []
        events: list[dict[str, Any]] = []
        poses = np.zeros((len(self.drives), len(COLUMNS)))
        details = []
        for number, vehicle in enumerate(self.engine.vehicles):
            if now - self._begun[number] > self.drives[number].seconds + 1e-6:
                self._begun[number] = before
                vehicle.begin(before)
            rows = self._sent(number, before, now)
            readings += [(number, one) for one in self.engine.push(number, rows, now)]
            place, belief, change = vehicle.look(now)
            if change:
                events.append({"vehicle": number, **change})
            status, keys = vehicle.status.value, {one["key"] for one in vehicle.status.reasons}
            flags = LOCALIZED * (status not in ("LOST", "ALIGNING"))
            flags |= TRUSTED * ("contradicted" not in keys)
            score = np.exp(-place.major / vehicle.limits.lost)
            poses[number] = (
                *place[:7], ORDER.index(status), score, *self._truth(number, now),
                place.sigma_profile, flags,
            )  # fmt: skip
            details.append(vehicle.detail(belief))
        active = [one._asdict() for one in self.faults if one.start <= now < one.end]
        shown = details if events or self.steps % DETAILS_EVERY == 0 else None
        tail = {"events": events, "faults": active, "details": shown}
        return Frame(now, poses, readings, b"", tail)

    def _sent(self, number: int, before: float, now: float) -> np.ndarray:
        one, shift = self.drives[number], round(self._begun[number] * SECOND)
        times = one.rows["time"]
        low, high = (round(at * SECOND) - shift for at in (before, now))
        begin = 0 if low == 0 else np.searchsorted(times, low, "right")
        rows = one.rows[begin : np.searchsorted(times, high, "right")].copy()
        rows["time"] += shift
        for fault in self.faults:
            if fault.vehicle == number and fault.start < now <= fault.end:
                rows = with_fault(rows, fault, self._concerned(number, fault), one.std)
        return rows

    def _concerned(self, number: int, fault: Switched) -> np.ndarray:
        """The sensors of a fault: without a source those that tell a position, or all."""
        if fault.source is not None:
            return np.array([fault.source])
        absolute = self.engine.vehicles[number].absolute
        return np.flatnonzero(absolute) if any(absolute) else np.arange(len(absolute))

    def _truth(self, number: int, now: float) -> np.ndarray:
        one = self.drives[number]
        row = round((now - self._begun[number]) / one.truth_step) - 1
        return one.truth[min(max(row, 0), len(one.truth) - 1)]


def fleet(plans: Sequence[Plan] = FLEET, progress: Callable[[str], None] = print) -> Fleet:
    """The fleet of some plans, simulated and compiled."""
    drives = []
    for plan in plans:
        progress(f"simulating {plan.name} ({plan.scenario})")
        drives.append(drive(plan))
    whole = Fleet(drives)
    whole.ready()
    return whole
