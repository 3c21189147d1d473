"""What a study is: a scenario, how it is scored, and the events at which it is."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ConfigError, ContractError
from kedge.core.registry import unknown
from kedge.estimation.log import SECOND, Log
from kedge.estimation.rig import Rig
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import schedule
from kedge.vehicles.undriven import Undriven

SCORES = ("pooled", "time-mean-rms")
STARTS = ("prior", "truth")


class Plan(NamedTuple):
    """What all runs share: their events, and at which of them they are scored."""

    log: Log
    events: Int[np.ndarray, " K"]
    """Those scored."""
    steps: Int[np.ndarray, " K"]
    """The step at whose end each scored event lies."""
    settled: Bool[np.ndarray, " K"]
    """Whether the burn-in is over."""
    time: Float[np.ndarray, " K"]  # s
    sensed: Int[np.ndarray, " E"]
    """The events with a reading."""
    sensor: Int[np.ndarray, " E"]
    sensed_settled: Bool[np.ndarray, " E"]
    sensed_time: Float[np.ndarray, " E"]  # s
    steps_settled: Bool[np.ndarray, " S"]
    """Of all steps."""
    windows: Mapping[str, "Window"] = {}


class Window(NamedTuple):
    """Some of the times of a run that are scored apart."""

    events: Bool[np.ndarray, " K"]
    """Of those scored."""
    sensed: Bool[np.ndarray, " E"]
    steps: Bool[np.ndarray, " S"]


@dataclass(frozen=True)
class Study:
    r"""A scenario, and how it is scored.

    ``score`` "pooled" is the root of the mean, over runs and times, of the squared error of a
    field, at the end of every step: $\sqrt{\overline{\lVert e \rVert^2}}$. "time-mean-rms" is
    the mean over runs and analysis times (after the readings of a time are taken in) of the
    root mean square over the state's components, $\overline{\lVert e \rVert / \sqrt n}$: the
    "rmse.a" of the data-assimilation literature.

    ``start`` "prior" gives filters the prior as it is; with "truth" its mean is the true state
    at time 0 plus an error drawn from its covariance.

    ``vehicles`` are the motion models of filters, by name, that have not the rig's. Where a
    guidance listens to each filter in turn, every filter has a truth of its own, with the same
    draws; each is scored in the loop that it closes.

    Filters are judged by ``field`` of the state: its position or whatever comes first, if none
    is named.
    """

    scenario: Scenario
    burn_in: float | int = 0.0  # s
    score: str = "pooled"
    start: str = "prior"
    seed: int = 0
    vehicles: Mapping[str, AbstractVehicle] = dataclasses.field(default_factory=dict)
    field: str = ""
    windows: Mapping[str, Sequence[Sequence[float]]] = dataclasses.field(default_factory=dict)
    """Stretches of time (from, to; s) that are scored apart, by name."""

    def check(self) -> None:
        """Refuse what cannot be run.

        Raises:
            ConfigError: an option is unknown or out of range, or no time is left to score.
        """
        for name, known in (("score", SCORES), ("start", STARTS)):
            if (value := getattr(self, name)) not in known:
                raise ConfigError(f"{name}: found {value!r}, expected one of {list(known)}")
        fields = type(self.scenario.rig.prior.mean)._fields
        if self.field and self.field not in fields:
            raise ConfigError(
                f"field: {unknown('field of the state', self.field, list(fields))}"
            )
        if not 0 <= self.seed < 2**63:
            raise ConfigError(f"seed: found {self.seed}, expected 0 or more, below 2^63")
        if not 0 <= self.burn_in < self.scenario.duration:
            raise ConfigError(
                f"burn_in: found {self.burn_in:g} s, expected 0 or more and less than the "
                f"duration, {self.scenario.duration:g} s"
            )

    def scenario_of(self, name: str) -> Scenario:
        """The scenario as a filter knows it: with its own motion model, if it has one.

        Raises:
            ContractError: that model has another state or control than the rig's.
        """
        rig, model = self.scenario.rig, self.vehicles.get(name)
        if model is None:
            return self.scenario
        given, known = (type(vehicle.nominal_control(0.0)) for vehicle in (rig.vehicle, model))
        if not known._fields:
            model = Undriven(model, rig.vehicle)
        elif given is not known:
            raise ContractError(
                f"filter {name!r}: its {type(model).__name__} is driven by {known._fields}, "
                f"but the rig's {type(rig.vehicle).__name__} by {given._fields}"
            )
        changed = Rig(model, rig.sensors, rig.prior)
        return dataclasses.replace(self.scenario, rig=changed)

    @cached_property
    def plan(self) -> Plan:
        """The schedule and the events to score.

        Raises:
            ConfigError: nothing happens after the burn-in.
        """
        return _plan_of(self)


def _plan_of(study: Study) -> Plan:
    scenario = study.scenario
    pooled = study.score == "pooled"
    # Without outputs: their rate is so low that there is none.
    rate = 1 / scenario.dt if pooled else 0.5 / scenario.duration
    recording = schedule(scenario, rate)
    stamps, burn_in = recording.stamps, round(study.burn_in * SECOND)
    sensor = np.asarray(recording.log.schedule.sensor)
    if pooled:
        events = recording.outputs
    else:
        last = np.append(stamps[1:] != stamps[:-1], True)
        # Sensors that fire at one time stand together: the last of them is the analysis.
        events = np.flatnonzero((sensor >= 0) & (last | ~np.append(sensor[1:] >= 0, False)))
    settled = stamps[events] > burn_in
    if not settled.any():
        raise ConfigError(f"burn_in: nothing is scored after {study.burn_in:g} s")
    sensed = np.flatnonzero(sensor >= 0)
    ends = np.arange(1, scenario.steps + 1) * scenario.dt
    plan = Plan(
        log=recording.log,
        events=events,
        steps=np.round(stamps[events] / (scenario.dt * SECOND)).astype(np.int64) - 1,
        settled=settled,
        time=stamps[events] / SECOND,
        sensed=sensed,
        sensor=sensor[sensed],
        sensed_settled=stamps[sensed] > burn_in,
        sensed_time=stamps[sensed] / SECOND,
        steps_settled=ends > study.burn_in + 1e-9,
    )
    return plan._replace(windows=_windows(study, plan, ends))


def _windows(study: Study, plan: Plan, ends: np.ndarray) -> dict[str, Window]:
    """The windows in which something is scored, and the rest after the burn-in."""
    if not study.windows:
        return {}

    def inside(time: np.ndarray, spans: Sequence[Sequence[float]]) -> np.ndarray:
        return np.any([(time > a + 1e-9) & (time <= b + 1e-9) for a, b in spans], axis=0)

    times = plan.time, plan.sensed_time, ends
    windows = {
        name: Window(*(inside(time, spans) for time in times))
        for name, spans in study.windows.items()
    }
    settled = plan.settled, plan.sensed_settled, plan.steps_settled
    taken = (np.any(masks, axis=0) for masks in zip(*windows.values(), strict=True))
    windows["else"] = Window(*(a & ~b for a, b in zip(settled, taken, strict=True)))
    return {name: window for name, window in windows.items() if window.events.any()}
