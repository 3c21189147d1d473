"""Badly scaled covariances and exact readings (law 16): finite, positive definite, always."""

import functools as ft
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core import registry
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractGaussianFilter, AbstractSensor, AbstractVehicle
from kedge.core.quantities import Acceleration3, Position3, Velocity3
from kedge.testing import quick_jit

GAUSSIAN = [
    name
    for name in registry.filters.names()
    if issubclass(registry.filters.get(name), AbstractGaussianFilter)
]


class State(NamedTuple):
    position: Position3
    velocity: Velocity3


class Noise(NamedTuple):
    acceleration: Acceleration3


class Body(AbstractVehicle[State, tuple, Noise]):
    """Constant velocity in space, with noise as unequal as the prior."""

    def step(self, state, control, noise, dt):
        change = noise.acceleration * dt
        return State(
            state.position + (state.velocity + change / 2) * dt, state.velocity + change
        )

    def noise_density(self):
        return Noise(jnp.array([1e2, 1e-1, 1e-4]))

    def start(self):
        return State(jnp.zeros(3), jnp.zeros(3))

    def nominal_control(self, time):
        return ()


class Seen(NamedTuple):
    position: Position3


class Exact(AbstractSensor[Seen]):
    """Reads the position without any noise."""

    reads = Seen
    measures = Seen

    def observe(self, state):
        return Seen(state.position)

    def noise_std(self, state):
        return Seen(jnp.zeros(3))


# Variances from 1e6 to 1e-8, everything correlated by .8.
STD = np.array([1e3, 1.0, 1e-2, 3e1, 1e-3, 1e-4])
COV = np.outer(STD, STD) * (0.8 + 0.2 * np.eye(6))


@ft.cache
def cycles(name):
    """Covariances after each prediction and each update, 30 of both."""
    filter, key = registry.filters.make(name), jax.random.key(0)

    @quick_jit
    def run(cov):
        def body(belief, _):
            before = filter.predict(Body(), belief, (), 0.1, key)
            after, _ = filter.update(Exact(), before, Seen(jnp.array([3e2, -0.5, 1e-3])), key)
            return after, (before.moments().cov, after.moments().cov)

        prior = filter.init(Gaussian(Body().start(), cov), key)
        return jax.lax.scan(body, prior, length=30)[1]

    return jax.tree.map(np.asarray, run(COV))


def correlation(cov):
    std = np.sqrt(np.diag(cov))
    return cov / np.outer(std, std)


def test_the_prior_is_as_bad_as_the_law_says():
    variances = np.diag(COV)
    assert (variances.max(), variances.min()) == (1e6, 1e-8)


@pytest.mark.parametrize("name", GAUSSIAN)
def test_predictions_are_positive_definite(name):
    for before in cycles(name)[0]:
        assert np.isfinite(before).all()
        np.testing.assert_array_equal(before, before.T)
        # In units of its own, so that the smallest variance counts as much as the largest.
        assert np.linalg.eigvalsh(correlation(before)).min() > 0


@pytest.mark.parametrize("name", [n for n in GAUSSIAN if n not in ("dead-reckoning", "raw")])
def test_an_exact_reading_leaves_no_doubt_and_no_negative_variance(name):
    for before, after in zip(*cycles(name), strict=True):
        assert np.isfinite(after).all()
        assert (np.diag(after) >= 0).all()
        # What was measured is known; what was not keeps the variance given what was.
        std = np.sqrt(np.diag(before))
        assert (np.abs(after[:3]) <= 1e-9 * np.outer(std[:3], std)).all()
        rest = before[3:, 3:] - before[3:, :3] @ np.linalg.solve(before[:3, :3], before[:3, 3:])
        scale = np.outer(std[3:], std[3:])
        np.testing.assert_allclose(after[3:, 3:] / scale, rest / scale, atol=1e-9)
        assert np.linalg.eigvalsh(correlation(after[3:, 3:])).min() > 0
