"""How fast an inertial solution alone loses its way: closed forms in its noise and biases."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jax import lax

from kedge.numerics.noise import process_std
from kedge.vehicles.strapdown import Imu, State, Strapdown

RUNS, STEPS, DT, GRAVITY = 3000, 200, 0.1, 9.81
STILL = State(jnp.zeros(3), jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0]))
FELT = Imu(jnp.array([0.0, 0.0, GRAVITY]), jnp.zeros(3))


@jax.jit
def scattered(vehicle, key):
    """Where runs are that stand still but for their noise."""
    shocks = process_std(vehicle, DT)[None, None] * jr.normal(key, (RUNS, STEPS, 6))

    def step(state, shock):
        return vehicle.step(state, FELT, Imu(shock[:3], shock[3:]), DT), None

    return jax.vmap(lambda own: lax.scan(step, STILL, own)[0].position)(shocks)


@pytest.mark.parametrize(("force", "rate"), [(4e-3, 0.0), (0.0, 9e-5)])
def test_noise_of_accelerometers_and_of_gyroscopes(key, force, rate):
    r"""$N t^{3/2} / \sqrt 3$ on each axis; $g N t^{5/2} / \sqrt{20}$ on the level ones.

    6000 to 9000 numbers tell a deviation to 0.9 %.
    """
    vehicle = Strapdown(
        accelerometer_noise=jnp.asarray(force), gyroscope_noise=jnp.asarray(rate)
    )
    position, time = np.asarray(scattered(vehicle, key)), STEPS * DT
    found = np.sqrt(np.mean(position**2, axis=0))
    if force:
        np.testing.assert_allclose(found, force * time**1.5 / 3**0.5, rtol=0.05)
    else:
        np.testing.assert_allclose(found[:2], GRAVITY * rate * time**2.5 / 20**0.5, rtol=0.05)
        assert found[2] < 0.01 * found[0]


def test_biases_that_nobody_knows():
    r"""$b t^2 / 2$ of an accelerometer (1 mg: 17.7 m in a minute), $g b t^3 / 6$ of a gyro."""
    count, step = 600, 0.1

    def drift(force, rate):
        told = Imu(FELT.specific_force + force, FELT.angular_rate + rate)
        calm = Imu(jnp.zeros(3), jnp.zeros(3))
        moved = lax.scan(
            lambda s, _: (Strapdown().step(s, told, calm, step), None), STILL, length=count
        )
        return moved[0].position

    once = jax.jit(drift)
    milli_g = jnp.array([9.80665e-3, 0.0, 0.0])
    np.testing.assert_allclose(once(milli_g, jnp.zeros(3)), [17.65, 0, 0], atol=0.01)
    slow = 1e-6  # rad/s about the left axis tips the nose down, and gravity pushes ahead
    found = once(jnp.zeros(3), jnp.array([0.0, slow, 0.0]))
    np.testing.assert_allclose(found[0], GRAVITY * slow * 60.0**3 / 6, rtol=0.01)
