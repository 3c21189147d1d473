"""A body that keeps its twist, against screw motion and the covariance of double integrals."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from kedge.core.manifolds import space
from kedge.numerics.noise import process_std
from kedge.testing import quick_jit
from kedge.vehicles.body_twist import BodyTwist, Control

VEHICLE = BodyTwist(acceleration_noise=0.3, angular_noise=0.2)
CALM = space(VEHICLE.noise_density()).unflatten(jnp.zeros(12))


def test_a_constant_twist_is_a_screw():
    """On a circle of radius v / w in the plane across the rate; against scipy's rotations."""
    rate, velocity = np.array([0.1, -0.2, 0.4]), np.array([1.5, 0.2, -0.1])
    start = VEHICLE.start()._replace(
        velocity_body=jnp.array(velocity), angular_rate=jnp.array(rate)
    )
    step = quick_jit(lambda s: VEHICLE.step(s, Control(), CALM, 0.01))
    state = start
    for _ in range(500):
        state = step(state)
    times = (np.arange(50_000) + 0.5) * 1e-4
    path = Rotation.from_rotvec(times[:, None] * rate[None]).apply(velocity).sum(axis=0) * 1e-4
    np.testing.assert_allclose(state.position, path, atol=1e-5)
    turn = Rotation.from_rotvec(5 * rate).as_quat()
    np.testing.assert_allclose(np.roll(state.attitude, -1), turn, atol=1e-12)


def test_noise_of_one_step_is_that_of_continuous_motion():
    """Double integral of white noise: d^2 [dt^3/3, dt^2/2; dt^2/2, dt], for any step."""
    dt, states = 0.7, space(VEHICLE.start())
    noises = space(CALM)

    @quick_jit
    def slopes(origin):
        def moved(noise):
            return VEHICLE.step(origin, Control(), noises.unflatten(noise), dt)

        mean = moved(noises.zeros())
        jacobian = jax.jacfwd(lambda n: states.boxminus(moved(n), mean))(noises.zeros())
        return jacobian * process_std(VEHICLE, dt)[None]

    root = slopes(VEHICLE.start()._replace(velocity_body=jnp.zeros(3)))
    cov = np.asarray(root @ root.T)
    expected = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    for first, second, density in ((0, 6, 0.3), (4, 10, 0.2)):
        pair = np.ix_([first, second], [first, second])
        np.testing.assert_allclose(cov[pair], density**2 * expected, atol=1e-12)
