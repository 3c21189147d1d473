"""Squared ranges against draws, and the four-state error filters of the literature."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.log import Readings
from kedge.estimation.reading import bind_reading
from kedge.estimation.rig import Installation
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.numerics.noise import process_std
from kedge.sensors.squared_ranges import Measurement, Reads, SquaredRanges
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import State
from kedge.vehicles.inertial_point import Control, InertialPoint

ANCHORS = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]])


@pytest.mark.parametrize("distance", [0.0, 0.05, 20.0])
def test_moments_are_those_of_squared_draws(distance):
    draws = np.random.default_rng(3).normal(distance, 0.05, 200_000) ** 2
    sensor = SquaredRanges(range_std=0.05).for_target(0)
    here = Reads(jnp.array([distance, 0.0]))
    error = draws.std() / np.sqrt(len(draws))
    assert float(sensor.observe(here).squared_range) == pytest.approx(
        draws.mean(), abs=5 * error
    )
    assert float(sensor.noise_std(here).squared_range) == pytest.approx(draws.std(), rel=0.01)


def open_loop(ins, ranges, dt, noise, std, cov):
    """The error filter of the paper, corrected: errors stay apart from the inertial solution.

    z = |p_ins - a|^2 - D^2, h(e) = 2 (p_ins - a) dp - |dp|^2, e = [dp, dv] = INS - truth.
    """
    F = np.block([[np.eye(2), dt * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
    unit = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    Q, error, track = noise**2 * np.kron(unit, np.eye(2)), np.zeros(4), []
    for place, measured in zip(ins, ranges, strict=True):
        error, cov = F @ error, F @ cov @ F.T + Q
        for anchor, squared in zip(ANCHORS, measured, strict=True):
            H = np.append(2 * (place - anchor) - 2 * error[:2], [0.0, 0.0])
            distance = (place - error[:2] - anchor) @ (place - error[:2] - anchor)
            R = 4 * distance * std**2 + 2 * std**4
            expected = 2 * (place - anchor) @ error[:2] - error[:2] @ error[:2]
            residual = (place - anchor) @ (place - anchor) - squared + std**2 - expected
            K = cov @ H / (H @ cov @ H + R)
            error, cov = error + K * residual, (np.eye(4) - np.outer(K, H)) @ cov
        track.append(place - error[:2])
    return np.array(track), cov


def test_open_loop_and_closed_loop_agree():
    random, dt, noise, std, count = np.random.default_rng(5), 0.1, 0.004, 0.05, 60
    pushes = random.normal(0, noise / np.sqrt(dt), (count, 2))
    truth = np.array([5.0, 4.0]) + 0.1 * dt * np.arange(1, count + 1)[:, None] * [2.0, 1.0]
    away = truth[:, None] - ANCHORS[None]
    ranges = (np.linalg.norm(away, axis=2) + random.normal(0, std, (count, 4))) ** 2
    speed = np.cumsum(pushes * dt, axis=0) + 0.1 * np.array([2.0, 1.0])
    middle = speed - pushes * dt / 2
    ins = np.array([5.03, 3.98]) + np.cumsum(middle * dt, axis=0)
    cov = np.diag([0.03**2] * 2 + [0.01**2] * 2)
    apart, cov_apart = open_loop(ins, ranges, dt, noise, std, cov)

    vehicle = InertialPoint(noise)
    installed = Installation("uwb", SquaredRanges(range_std=std))
    filter = ExtendedKalman()

    @quick_jit
    def closed(belief, pushes, ranges):
        def body(belief, inputs):
            push, measured = inputs
            belief = filter.predict(vehicle, belief, Control(push), dt, jax.random.key(0))
            for index in range(4):
                reading = Readings(Measurement(measured[index]), jnp.asarray(index))
                model, z = bind_reading(installed, reading)
                belief, _ = filter.update(model, belief, z, jax.random.key(0))
            return belief, belief.mean.position

        return jax.lax.scan(body, belief, (pushes, ranges))

    begin = State(jnp.array([5.03, 3.98]), 0.1 * jnp.array([2.0, 1.0]))
    last, together = closed(
        Gaussian(begin, jnp.asarray(cov)), jnp.asarray(pushes), jnp.asarray(ranges)
    )
    np.testing.assert_allclose(together, apart, atol=1e-9)
    np.testing.assert_allclose(last.cov, cov_apart, rtol=1e-6, atol=1e-12)


def test_the_process_noise_is_the_continuous_one():
    vehicle, dt = InertialPoint(0.7), 0.3

    def moved(noise):
        calm = vehicle.noise_density()
        parts = type(calm)(noise[:2], noise[2:])
        return jnp.concatenate(
            vehicle.step(vehicle.start(), vehicle.nominal_control(0.0), parts, dt)
        )

    G = jax.jacfwd(moved)(jnp.zeros(4)) * process_std(vehicle, dt)[None]
    unit = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    np.testing.assert_allclose(G @ G.T, 0.49 * np.kron(unit, np.eye(2)), rtol=1e-12)
