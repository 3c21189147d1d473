"""Inertial navigation against motions that are known."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from kedge.testing import quick_jit
from kedge.vehicles.strapdown import GRAVITY, Imu, ImuWithSlopes, State, Strapdown

CALM = Imu(jnp.zeros(3), jnp.zeros(3))


def path(start, imu, dt, count):
    """The state after ``count`` steps under what ``imu(time)`` measures."""

    @quick_jit
    def end():
        def body(state, time):
            # What is measured in the middle of the step stands for it.
            return Strapdown().step(state, imu(time + dt / 2), CALM, dt), None

        return jax.lax.scan(body, start, jnp.arange(count) * dt)[0]

    return end()


def level(speed):
    return State(jnp.zeros(3), jnp.array([speed, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0, 0.0]))


def test_what_falls_freely_feels_nothing():
    after = path(level(2.0), lambda _: CALM, 0.1, 20)
    np.testing.assert_allclose(after.position, [4, 0, GRAVITY[2] * 2], rtol=1e-12)
    np.testing.assert_allclose(after.velocity, [2, 0, GRAVITY[2] * 2], rtol=1e-12)


def test_a_circle_at_constant_speed():
    """Heading and velocity turn together; the force towards the centre is v times the rate."""
    rate, speed, dt, count = 0.5, 3.0, 0.01, 400
    imu = Imu(jnp.array([0.0, speed * rate, -GRAVITY[2]]), jnp.array([0.0, 0.0, rate]))
    after = path(level(speed), lambda _: imu, dt, count)
    turn = rate * dt * count
    radius = speed / rate
    place = radius * np.array([np.sin(turn), 1 - np.cos(turn), 0.0])
    np.testing.assert_allclose(after.position, place, atol=1e-5)
    np.testing.assert_allclose(
        after.velocity, speed * np.array([np.cos(turn), np.sin(turn), 0]), atol=1e-5
    )
    expected = [np.cos(turn / 2), 0, 0, np.sin(turn / 2)]
    np.testing.assert_allclose(after.attitude, expected, atol=1e-12)


def test_attitude_composes_the_turns_of_the_body():
    """A turn about a body axis that moves: the product of all small rotations, by scipy."""

    def rate(time, stack):
        return stack([0.3 * time, 0.5 + 0.0 * time, 0.2 - 0.4 * time])

    dt, count = 0.01, 300
    after = path(level(0.0), lambda time: Imu(jnp.zeros(3), rate(time, jnp.stack)), dt, count)
    middle = (np.arange(count) + 0.5) * dt
    expected = Rotation.identity()
    for time in middle:
        expected = expected * Rotation.from_rotvec(rate(time, np.array) * dt)
    found = Rotation.from_quat(np.asarray(after.attitude)[[1, 2, 3, 0]])
    assert (expected.inv() * found).magnitude() < 1e-12


def test_coning_and_sculling_of_readings_that_are_linear_within_a_step():
    """One step with slopes is a thousand without, 20 times nearer than one without is."""
    dt, count, trials = 0.02, 1000, 8
    random = np.random.default_rng(3)
    force, rate, force_slope, rate_slope = (
        scale * random.normal(size=(trials, 3)) for scale in (5.0, 0.5, 300.0, 30.0)
    )
    start = State(jnp.zeros(3), jnp.zeros(3), jnp.array([0.6, 0.0, 0.8, 0.0]))

    @quick_jit
    @jax.vmap
    def steps(force, rate, force_slope, rate_slope):
        def fine(state, i):
            after = (i + 0.5) * dt / count - dt / 2
            imu = Imu(force + force_slope * after, rate + rate_slope * after)
            return Strapdown().step(state, imu, CALM, dt / count), None

        slopes = ImuWithSlopes(force, rate, force_slope, rate_slope)
        return (
            jax.lax.scan(fine, start, jnp.arange(count))[0],
            Strapdown().step(start, Imu(force, rate), CALM, dt),
            Strapdown(slopes=True).step(start, slopes, CALM, dt),
        )

    exact, plain, better = steps(force, rate, force_slope, rate_slope)
    for of in State._fields:
        without, gap = (
            np.linalg.norm(getattr(one, of) - getattr(exact, of), axis=1)
            for one in (plain, better)
        )
        assert (gap < without / 20).all(), (of, gap / without)
