"""All events at once, against one after the other and against brute force."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import kedge
from kedge.core.contracts import AbstractSensor
from kedge.core.errors import ContractError
from kedge.core.quantities import Position, Range
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.parallel import estimate_in_parallel, smooth_in_parallel
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.kalman import Kalman
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import ConstantVelocity, Control, State

PLACE, SPREAD, STD, DENSITY, DT = np.array([0.0, 3.0]), 0.8, 0.2, 0.5, 1.0
RANGES = np.array([2.6, 1.9, 2.2, 3.4, 4.3])


class Reads(NamedTuple):
    position: Position


class Seen(NamedTuple):
    range: Range


class Beacon(AbstractSensor[Seen]):
    """The distance from a beacon."""

    reads = Reads
    measures = Seen

    def observe(self, state):
        return Seen(jnp.sqrt(jnp.sum((state.position - PLACE) ** 2)))

    def noise_std(self, state):
        return Seen(jnp.array(STD))


PRIOR = kedge.Gaussian(
    State(jnp.array([-2.0, 0.5]), jnp.array([1.0, 0.0])), SPREAD**2 * jnp.eye(4)
)


def ranging():
    rig = Rig(ConstantVelocity(DENSITY), (Installation("beacon", Beacon()),), PRIOR)
    count = len(RANGES)
    log = Log(
        Schedule(DT * jnp.arange(1.0, count + 1), jnp.zeros(count, int), jnp.arange(count)),
        Control(),
        (Readings(Seen(jnp.asarray(RANGES)), jnp.zeros(count, int)),),
    )
    return rig, log


def most_probable():
    """The trajectory by least squares over the start and the noise of each step."""
    start = np.array([-2.0, 0.5, 1.0, 0.0])

    def drive(unknown):
        states, state = [], start + SPREAD * unknown[:4]
        for push in unknown[4:].reshape(-1, 2) * DENSITY / np.sqrt(DT):
            position = state[:2] + state[2:] * DT + push * DT**2 / 2
            state = np.concatenate([position, state[2:] + push * DT])
            states.append(state)
        return np.array(states)

    def away(unknown):
        gap = np.linalg.norm(drive(unknown)[:, :2] - PLACE, axis=1) - RANGES
        return np.concatenate([unknown, gap / STD])

    found = least_squares(away, np.zeros(4 + 2 * len(RANGES)), xtol=1e-14, ftol=1e-14)
    return drive(found.x)


@pytest.mark.slow
def test_iterations_end_at_the_most_probable_trajectory():
    rig, log = ranging()
    _, smoothed = quick_jit(lambda: smooth_in_parallel(rig, log, iterations=15))()
    mean = smoothed.moments.mean
    found = np.concatenate([mean.position, mean.velocity], axis=1)
    np.testing.assert_allclose(found, most_probable(), atol=1e-6)


def test_what_cannot_be_used_is_left_out():
    """Missing, half missing, infinite and late readings, as the sequential filter has it."""
    values = np.array(
        [[1.0, 2.0], [np.nan, np.nan], [np.nan, 3.0], [np.inf, 0.0], [2.0, 2.0], [1, 1]]
    )
    time = jnp.array([0.5, 1.0, 1.7, 2.0, 1.2, 3.0])
    sensor = jnp.array([0, 0, 0, 0, 0, -1])
    rig = Rig(ConstantVelocity(), (Installation("gnss", Gnss(std=0.7)),), PRIOR)
    log = Log(
        Schedule(time, sensor, jnp.arange(6)),
        Control(),
        (Readings(Measurement(jnp.asarray(values)), jnp.zeros(6, int)),),
    )
    expected = quick_jit(lambda: estimate(Kalman(), rig, log))()
    found = quick_jit(lambda: estimate_in_parallel(rig, log))()
    verdicts = [Verdict(v) for v in np.asarray(found.outcome.verdict)]
    assert verdicts[3:] == [Verdict.NOT_FINITE, Verdict.LATE, Verdict.NONE]
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_what_is_not_linear_is_refused():
    with pytest.raises(ContractError, match="Seen depends nonlinearly"):
        smooth_in_parallel(*ranging())
    with pytest.raises(ContractError, match="iterations is -1, must be at least 0"):
        smooth_in_parallel(*ranging(), iterations=-1)


def test_gates_are_refused():
    rig = Rig(ConstantVelocity(), (Installation("gnss", Gnss(), gate=0.01),), PRIOR)
    with pytest.raises(ContractError, match="sensor 'gnss' has a gate or robust noise"):
        estimate_in_parallel(rig, ranging()[1])
