"""Whether a sensor errs with a memory: how long, and by how much."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kedge.checking.program import Evaluated, Gain, Program, gain
from kedge.checking.search import CLEAR, STEADY, Trial
from kedge.checking.setting import Change, Setting
from kedge.checking.streams import Judged
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.core.manifolds import space_of
from kedge.estimation.correlated_error import CorrelatedError
from kedge.estimation.error_states import with_error, with_errors
from kedge.estimation.rig import Rig
from kedge.evaluation.consistency import Whiteness, whiteness

LAGS = 20
CORRELATED = 0.1
"""Autocorrelation from which on residuals are worth a second look."""
FACTORS = (0.5, 1.0, 2.0, 4.0)
"""Standard deviations of an error, in those of the sensor's white noise."""
MEMORIES = (1.0, 4.0, 15.0, 60.0)  # s
MOST_STATES = 24
"""Errors that may be added to the state; where there are more targets all share one."""


class Memory(NamedTuple):
    """How the residuals of a sensor hang together over time."""

    whiteness: Whiteness
    time_constant: float | None
    """s until the correlation has fallen to 1/e; None if they are white."""

    @property
    def suspicious(self) -> bool:
        """Whether there may be an error with a memory."""
        return not self.whiteness.white and self._most > CORRELATED

    @property
    def _most(self) -> float:
        return float(np.nanmax(np.abs(self.whiteness.autocorrelation)))


def memory(readings: Judged) -> Memory | None:
    """Of one sensor's residuals, each target's by themselves; None if they are too few."""
    by_target = [readings.white[readings.target == t] for t in np.unique(readings.target)]
    gap = np.full((LAGS, readings.white.shape[1]), np.nan)
    rows = np.concatenate([part for white in by_target for part in (white, gap)])
    rows = rows[:, (np.abs(np.nan_to_num(rows)) > 0).any(axis=0)]
    if len(readings.time) < 5 * LAGS or not rows.shape[1]:
        return None
    try:
        test = whiteness(rows, LAGS, 0.999)
    except DataError:
        return None
    first = readings.time[readings.target == readings.target[0]]
    step, falls = float(np.median(np.diff(first))), test.autocorrelation < np.exp(-1)
    lag = int(np.argmax(falls)) + 1 if falls.any() else LAGS
    return Memory(test, None if test.white else lag * step)


def noise_std(setting: Setting, evaluated: Evaluated, place: int) -> Float[np.ndarray, " m"]:
    """The white noise that a rig says a sensor has, in the middle of what its log met."""
    installation, readings = setting.rig.sensors[place], setting.line.readings[place]
    schedule = evaluated.log.schedule
    events = np.flatnonzero(np.asarray(schedule.sensor) == place)
    events = events[np.linspace(0, len(events) - 1, min(len(events), 50)).astype(int)]
    rows = np.asarray(schedule.row)[events]
    if readings.cov is not None:
        return np.sqrt(np.median(np.asarray(readings.cov)[rows], axis=0).diagonal())
    target = np.maximum(np.asarray(readings.target)[rows], 0)
    states = jax.tree.map(
        lambda leaf: jnp.asarray(leaf)[events], evaluated.estimates.moments.mean
    )
    cov = jax.jit(jax.vmap(installation.noise_cov))(states, jnp.asarray(target))
    return np.sqrt(np.median(np.asarray(cov), axis=0).diagonal())


def with_memory(rig: Rig, place: int, std: Float[np.ndarray, " m"], seconds: float) -> Rig:
    """The rig with an error of the sensor at ``place``."""
    installation = rig.sensors[place]
    targets = installation.targets or 0
    by_target = 1 < targets * space_of(installation.sensor.measures).size <= MOST_STATES
    error = CorrelatedError(jnp.asarray(std), jnp.asarray(seconds), by_target)
    installation = dataclasses.replace(installation, error=error)
    sensors = (*rig.sensors[:place], installation, *rig.sensors[place + 1 :])
    return with_errors(dataclasses.replace(rig, sensors=sensors))


def error_trial(
    filter: AbstractFilter, setting: Setting, base: Evaluated, place: int
) -> tuple[Trial, Program, Setting] | None:
    """An error with a memory at its best values, and what it makes of the setting.

    None where the rig has such an error already.
    """
    installation = setting.rig.sensors[place]
    if installation.error is not None:
        return None
    noise = noise_std(setting, base, place)
    carrying = setting._replace(rig=with_memory(setting.rig, place, noise, 10.0))
    program = Program(filter, carrying)
    gains: dict[tuple[float, float], Gain] = {}

    def at(factor: float, seconds: float) -> Setting:
        rig = with_error(carrying.rig, installation.name, jnp.asarray(factor * noise), seconds)
        return carrying._replace(rig=rig)

    def total(factor: float, seconds: float) -> float:
        if (factor, seconds) not in gains:
            gains[factor, seconds] = gain(program.evaluate(at(factor, seconds)), base)
        return gains[factor, seconds].total

    best = max(((f, s) for f in FACTORS for s in MEMORIES), key=lambda pair: total(*pair))
    for ratio in (1.5, 1.2):
        near = [
            (best[0] * a, best[1] * b)
            for a in (1 / ratio, 1, ratio)
            for b in (1 / ratio, 1, ratio)
        ]
        best = max(near, key=lambda pair: total(*pair))
    change = Change("error", installation.name, "", best[0], best[1])
    return Trial(change, gains[best], None), program, at(*best)


def is_clear(trial: Trial, other: Trial | None) -> bool:
    """Whether an error with a memory says more than any simpler hypothesis."""
    clear = trial.gain.total > CLEAR and trial.gain.steady > STEADY
    return clear and (other is None or trial.gain.total > other.gain.total + CLEAR)
