"""Independent readings may come one after the other or together (law 2), in any order."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Position, Velocity
from kedge.core.registry import filters
from kedge.sensors import gnss, velocity
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import State


class Both(NamedTuple):
    position: Position
    velocity: Velocity


class Together(AbstractSensor[Both]):
    """Position and velocity in one reading."""

    reads = Both
    measures = Both

    def observe(self, state):
        return Both(*state)

    def noise_std(self, state):
        return Both(jnp.full(2, 0.7), jnp.full(2, 0.3))


PRIOR = Gaussian(
    State(jnp.array([0.3, -0.2]), jnp.array([1.0, 0.5])),
    jnp.array(
        [[2.0, 0.5, 0.3, 0.0], [0.5, 1.0, 0.0, 0.2], [0.3, 0.0, 0.4, 0.1], [0.0, 0.2, 0.1, 0.5]]
    ),
)


@pytest.mark.parametrize("name", ["kalman", "extended", "unscented"])
def test_one_after_the_other_is_both_at_once(name, key):
    """FilterPy's unscented filter keeps its old sigma points and gets P00 wrong, fourfold."""
    filter = filters.make(name)
    first = gnss.Gnss(std=0.7), gnss.Measurement(jnp.array([0.9, 0.1]))
    second = velocity.MapVelocity(std=0.3), velocity.Measurement(jnp.array([0.8, 0.9]))

    @quick_jit
    def every(prior):
        def after(*pairs):
            belief, score = prior, 0.0
            for sensor, seen in pairs:
                belief, innovation = filter.update(sensor, belief, seen, key)
                score = score + innovation.log_likelihood
            return belief, score

        joint = Together(), Both(first[1].position, second[1].velocity)
        return after(joint), after(first, second), after(second, first)

    (together, score), *orders = every(PRIOR)
    for belief, total in orders:
        np.testing.assert_allclose(belief.cov, together.cov, rtol=1e-12, atol=1e-14)
        for a, b in zip(belief.mean, together.mean, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12)
        np.testing.assert_allclose(total, score, rtol=1e-12)
