"""Gyroscopes at rest read their bias."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kedge.core.beliefs import Gaussian
from kedge.core.quantities import AngularRate3
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.zero_velocity import AtRest, ZeroRate
from kedge.testing import quick_jit


class State(NamedTuple):
    gyroscope_bias: AngularRate3


def test_four_seconds_at_rest_calibrate_gyroscopes():
    """40 means over 0.1 s of noise N: the bias is their mean, known to N / sqrt(4 s)."""
    density, bias = 8.7e-5, np.array([1.2e-3, -0.4e-3, 1.7e-3])
    sensor = ZeroRate(std=density / 0.1**0.5)
    noise = np.random.default_rng(3).standard_normal((40, 3))
    read = bias + density / 0.1**0.5 * noise

    @quick_jit
    def step(belief, reading):
        key = jax.random.key(0)
        return ExtendedKalman().update(sensor, belief, AtRest(reading), key)[0]

    belief = Gaussian(State(jnp.zeros(3)), 1e6 * jnp.eye(3))
    for reading in read:
        belief = step(belief, jnp.asarray(reading))
    np.testing.assert_allclose(belief.mean.gyroscope_bias, read.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(belief.cov, density**2 / 4.0 * np.eye(3), rtol=1e-9, atol=1e-20)
