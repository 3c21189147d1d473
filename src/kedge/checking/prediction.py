"""Readings that are withheld: how many fall into the region where they were expected."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Bool, Float, Int

from kedge.checking.program import Program
from kedge.checking.setting import Setting
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import Innovation
from kedge.estimation.reading import bind_reading
from kedge.estimation.rig import Installation
from kedge.evaluation.consistency import chi_square_bound
from kedge.filters.gaussian.extended import ExtendedKalman

HORIZONS = (1.0, 5.0, 20.0, float("inf"))
"""s for which readings are withheld; infinity is for good."""
FEWEST = 5
"""Stretches from which on a share says something."""


class Coverage(NamedTuple):
    """Predictions of readings of one sensor that were withheld."""

    horizon: float
    """s since the last reading of it that was used."""
    inside: float
    """Share in the region that should hold 95 %."""
    stretches: int
    """How often it was withheld; the last reading of each stretch counts, for good: all."""
    nis: float
    """Median of NIS by its degrees of freedom; about 0.5 to 0.7 if it is right."""


def coverage(program: Program, setting: Setting, place: int) -> list[Coverage]:
    """Of one sensor, by horizon."""
    log = setting.log()
    time, sensor = np.asarray(log.schedule.time), np.asarray(log.schedule.sensor)
    of_sensor = sensor == place
    usual = float(np.median(np.diff(time[of_sensor]))) if of_sensor.sum() > 2 else np.inf
    scores = []
    for horizon in HORIZONS:
        period = 3 * max(horizon, 5 * usual)
        if horizon < usual or (np.isfinite(horizon) and time[-1] < 2 * period):
            continue
        phase = time % period if np.isfinite(horizon) else time
        withheld = of_sensor & (phase >= (period - horizon if np.isfinite(horizon) else 0.0))
        if not withheld.any():
            continue
        nis, dof, at = _held_back(program, setting, log, place, withheld)
        number = np.floor(time[at] / period) if np.isfinite(horizon) else np.arange(len(at))
        last = np.flatnonzero(np.diff(np.append(number, -1)) != 0)
        nis, dof = nis[last], dof[last]
        known = np.isfinite(nis) & (dof > 0)
        if known.sum() < FEWEST:
            continue
        bounds = np.array([chi_square_bound(int(d), 0.95) for d in dof[known]])
        share = float(np.mean(nis[known] <= bounds))
        typical = float(np.median(nis[known] / dof[known]))
        scores.append(Coverage(horizon, share, int(known.sum()), typical))
    return scores


def _held_back(
    program: Program, setting: Setting, log: Any, place: int, withheld: Bool[np.ndarray, " T"]
) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, " k"], np.ndarray]:
    """NIS and degrees of freedom of the readings that are withheld, and their events."""
    schedule = log.schedule
    masked = jnp.asarray(np.where(withheld, -1, np.asarray(schedule.sensor)))
    without = log._replace(schedule=schedule._replace(sensor=masked))
    moments = program.evaluate(setting, without).estimates.moments
    target = np.asarray(setting.line.readings[place].target)
    at = np.flatnonzero(withheld)
    at = at[target[np.asarray(schedule.row)[at]] >= 0]
    if len(at) == 0:
        return np.zeros(0), np.zeros(0, int), at
    # As many as a power of two: few programs to compile.
    size = 1 << max(len(at) - 1, 1).bit_length()
    padded = np.resize(at, size)
    rows = np.asarray(schedule.row)[padded]
    readings = jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], log.readings[place])
    beliefs = jax.tree.map(lambda leaf: jnp.asarray(leaf)[padded], moments)
    score = _foreseen(setting.rig.sensors[place], beliefs, readings)
    return np.asarray(score.nis)[: len(at)], np.asarray(score.dof)[: len(at)], at


@eqx.filter_jit
def _foreseen(installation: Installation, beliefs: Gaussian, readings: Any) -> Innovation:
    def one(belief: Gaussian, reading: Any) -> Innovation:
        model, measurement = bind_reading(installation, reading)
        return ExtendedKalman().update(model, belief, measurement, jr.key(0))[1]

    return jax.vmap(one)(beliefs, readings)
