"""Densities become variances that add up to the same at every step length."""

import jax.numpy as jnp
import numpy as np

from kedge.numerics.noise import process_std
from kedge.vehicles.unicycle import Unicycle


def test_noise_held_over_a_step_integrates_to_its_density():
    vehicle = Unicycle(speed_noise=0.3, yaw_rate_noise=0.02)
    for dt in (0.01, 1.0, 4.0):
        # Held for dt, n = 1/dt times a second: the variance of the integral over 1 s.
        variance = (process_std(vehicle, dt) * dt) ** 2 / dt
        np.testing.assert_allclose(variance, [0.3**2, 0.02**2])


def test_a_vehicle_without_noise_has_none():
    assert jnp.all(process_std(Unicycle(speed_noise=0.0, yaw_rate_noise=0.0), 0.1) == 0)
