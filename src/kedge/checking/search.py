"""Which hypothesis foresees a log better than the rig as it is, and by how much."""

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from kedge.checking.program import Evaluated, Gain, Program, gain
from kedge.checking.setting import CONTROL, Change, Setting, changed, has_arm, noise_of
from kedge.core.manifolds import Circle, charts_of, space_of
from kedge.core.verdicts import Verdict

STEPS = {"scale": (0.02, 0.3), "clock": (0.04, 0.5), "arm": (0.1, 3.0), "noise": (0.3, 3.0)}
"""First step of a search by kind, and how far it goes."""
HARDLY = 3.0
"""Gain below which a hypothesis is not looked into further."""
CLEAR, STEADY = 12.0, 3.0
"""Gain, and its mean in standard errors, from which on a hypothesis holds."""
LEAST = {"scale": 0.01, "clock": 0.02, "arm": 0.05, "noise": math.log(1.3)}
"""Values below which a rig need not be changed."""
SUSPECTS = 5
"""Targets of a map, the worst first, that may have been exchanged."""


class Trial(NamedTuple):
    """A hypothesis at its best value."""

    change: Change
    gain: Gain
    std: float | None
    """How far the log lets its value be known; None for what has no value or no curvature."""

    @property
    def holds(self) -> bool:
        """Whether the log is foreseen better by it, clearly and throughout."""
        least = LEAST.get(self.change.kind, 0.0)
        clear = self.gain.total > CLEAR and self.gain.steady > STEADY
        return clear and abs(self.change.value) >= least


def hypotheses(setting: Setting, evaluated: Evaluated) -> Iterator[Change]:
    """All that may be wrong with a setting."""
    controls = setting.line.controls
    for label, _ in _components(controls):
        yield Change("scale", CONTROL, label)
        yield Change("sign", CONTROL, label)
    if noise_of(setting, "vehicle"):
        yield Change("noise", "vehicle")
    for place, installation in enumerate(setting.rig.sensors):
        name, readings = installation.name, setting.line.readings[place]
        if not (np.asarray(readings.target) >= 0).any():
            continue
        for label, is_scaled in _components(readings.measurement):
            if is_scaled:
                yield Change("scale", name, label)
            yield Change("sign", name, label)
        yield Change("clock", name)
        if has_arm(setting.rig, installation):
            yield Change("arm", name, "x")
            yield Change("arm", name, "y")
        if noise_of(setting, name) or readings.cov is not None:
            yield Change("noise", name)
        if (installation.targets or 0) > 1:
            for one, other in itertools.combinations(_worst(setting, evaluated, place), 2):
                yield Change("exchange", name, f"{one},{other}")


def _components(values: object) -> Iterator[tuple[str, bool]]:
    """The components that can have another sign, and whether they can have another scale."""
    space, at = space_of(type(values)), 0
    for field, chart in charts_of(type(values)).items():
        flat = chart.shape == chart.tangent_shape and not field.startswith("position")
        for place in range(chart.size):
            if flat and np.size(getattr(values, field)):
                yield space.labels[at + place], not isinstance(chart, Circle)
        at += chart.size


def _worst(setting: Setting, evaluated: Evaluated, place: int) -> list[int]:
    """The targets of a sensor that are foreseen worst."""
    schedule, outcome = evaluated.log.schedule, evaluated.estimates.outcome
    events = np.flatnonzero(np.asarray(schedule.sensor) == place)
    target = np.asarray(setting.line.readings[place].target)[np.asarray(schedule.row)[events]]
    verdict = np.asarray(outcome.verdict)[events]
    judged = (verdict == Verdict.FUSED) | (verdict == Verdict.GATED)
    nis = np.asarray(outcome.nis)[events]
    worst = {
        int(t): float(np.mean(nis[judged & (target == t)])) for t in np.unique(target[judged])
    }
    return sorted(sorted(worst, key=lambda t: -worst[t])[:SUSPECTS])


def tried(program: Program, setting: Setting, base: Evaluated, change: Change) -> Trial:
    """A hypothesis at the value that foresees best: a line search, closed by a parabola."""
    if change.kind not in STEPS:
        return Trial(change, gain(program.evaluate(changed(setting, change)), base), None)
    step, most = STEPS[change.kind]
    gains = {0.0: Gain(0.0, 0.0)}

    def at(value: float) -> float:
        if value not in gains:
            trial = changed(setting, change._replace(value=value))
            gains[value] = gain(program.evaluate(trial), base)
        return gains[value].total

    lower = 0.0 if change.kind == "noise" else at(-step)
    curvature = -(at(step) + lower) / step**2
    std = 1 / math.sqrt(curvature) if curvature > 0 and change.kind != "noise" else None
    best = max((step, -step), key=at) if change.kind != "noise" else step
    near = _top(gains, most)
    if abs(near) > 0.02 * step and curvature * near**2 / 2 > HARDLY / 4:
        at(near)
        best = max(gains, key=lambda value: gains[value].total) or best
    if at(best) > HARDLY / 4:
        while abs(best) < most and at(2 * best) > at(best):
            best *= 2
        for _ in range(2):
            at(_top(gains, most))
    best = max(gains, key=lambda value: gains[value].total)
    return Trial(change._replace(value=best), gains[best], std)


def _top(gains: Mapping[float, Gain], most: float) -> float:
    """Where a parabola through the best value and its neighbours is highest."""
    line = sorted(gains)
    place = int(np.argmax([gains[value].total for value in line]))
    if not 0 < place < len(line) - 1:
        return line[place]
    x = np.array(line[place - 1 : place + 2])
    a, b, _ = np.polyfit(x, [gains[float(value)].total for value in x], 2)
    return float(np.clip(-b / (2 * a), -most, most)) if a < 0 else line[place]
