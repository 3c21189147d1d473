"""On a linear model all Gaussian filters are the Kalman filter (laws 1, 2 and 12).

The model, its belief and its readings are drawn by hypothesis; one program runs every filter.
"""

import functools as ft
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractGaussianFilter, AbstractMeasurementModel
from kedge.core.quantities import Position, Velocity
from kedge.core.registry import filters
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import ConstantVelocity, Control, State

NAMES = [
    name
    for name in filters.names()
    if issubclass(filters.get(name), AbstractGaussianFilter)
    and name not in ("dead-reckoning", "raw")
]
LIGHT = {"iterations": 2, "halvings": 1}
RELINEARISED = ("iterated", "posterior-linearisation")


class One(NamedTuple):
    position: Position


class Two(NamedTuple):
    position: Position
    velocity: Velocity


class Mix(AbstractMeasurementModel):
    """Linear combinations of the state's four components, with any noise."""

    kind: type
    slope: jax.Array
    cov: jax.Array

    def expect(self, state):
        seen = self.slope @ jnp.concatenate([state.position, state.velocity])
        return self.kind(*(seen[2 * i : 2 * i + 2] for i in range(len(self.kind._fields))))

    def noise_cov(self, state):
        return self.cov

    def dof(self):
        return self.cov.shape[0]


def make(name):
    return filters.make(name, **(LIGHT if name in RELINEARISED else {}))


def flat(belief):
    moments = belief.moments()
    return jnp.concatenate([moments.mean.position, moments.mean.velocity]), moments.cov


@ft.cache
def runs(names):
    """Each filter's moments after a prediction and two readings: in turn, and as one."""

    @quick_jit
    def run(mean, root, slope, spread, values):
        key = jax.random.key(0)
        prior = Gaussian(State(mean[:2], mean[2:]), root @ root.T)
        parts = [spread[:2, :2] @ spread[:2, :2].T, spread[2:, 2:] @ spread[2:, 2:].T]
        none = jnp.zeros((2, 2))
        both = Mix(Two, slope, jnp.block([[parts[0], none], [none, parts[1]]]))
        found = {}
        for name in names:
            filter = make(name)
            belief = filter.predict(
                ConstantVelocity(0.4), filter.init(prior, key), Control(), 0.7, key
            )
            once, score = filter.update(both, belief, Two(values[:2], values[2:]), key)
            twice, total = belief, 0.0
            for i in (0, 1):
                own = slice(2 * i, 2 * i + 2)
                model = Mix(One, slope[own], parts[i])
                twice, one = filter.update(model, twice, One(values[own]), key)
                total = total + one.log_likelihood
            found[name] = flat(once), flat(twice), score.log_likelihood, total, score.nis
        return found

    return run


FAST = ("kalman", "unscented", "cubature", "iterated", "square-root")
cases = pytest.mark.parametrize(
    "names",
    [
        pytest.param(FAST, id="fast"),
        pytest.param(("kalman", *(n for n in NAMES if n not in FAST)), marks=pytest.mark.slow),
    ],
)


@cases
@given(seed=st.integers(0, 2**32 - 1))
def test_every_gaussian_filter_is_the_kalman_filter(names, seed):
    """And two readings in turn are one joint reading, likelihood included."""
    random = np.random.default_rng(seed)
    mean, values = 3 * random.normal(size=4), 3 * random.normal(size=4)
    root, slope = random.normal(size=(4, 4)), random.normal(size=(4, 4))
    spread = random.normal(size=(4, 4)) + 2 * np.eye(4)
    found = runs(names)(mean, root, slope, spread, values)
    exact, scale = found["kalman"][0], np.abs(root @ root.T).max()
    for once, twice, joint, total, nis in found.values():
        for some, other in zip((*once, *twice), (*exact, *exact), strict=True):
            np.testing.assert_allclose(some, other, atol=1e-8 * scale, rtol=1e-8)
        np.testing.assert_allclose([joint, total], found["kalman"][2], rtol=1e-7)
        np.testing.assert_allclose(nis, found["kalman"][4], rtol=1e-7)


@pytest.mark.parametrize(
    ("name", "iterations"),
    [
        ("iterated", 1),
        *(pytest.param("iterated", n, marks=pytest.mark.slow) for n in (3, 7)),
        *(
            pytest.param("posterior-linearisation", n, marks=pytest.mark.slow)
            for n in (1, 3, 7)
        ),
    ],
)
def test_any_number_of_iterations_is_the_kalman_filter(name, iterations, key):
    """Law 1: a reading is counted once, not once an iteration (as dynamax 1.0.3 does)."""
    cov = np.array([[2.0, 0.3, 0, 0], [0.3, 1.0, 0, 0], [0, 0, 0.5, 0], [0, 0, 0, 0.1]])
    prior = Gaussian(State(jnp.zeros(2), jnp.ones(2)), jnp.asarray(cov))
    model = Mix(One, np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0]]), 0.01 * np.eye(2))

    @quick_jit
    def both(prior):
        values = One(jnp.array([5.0, -4.0]))
        chosen = filters.make(name, iterations=iterations)
        return [flat(f.update(model, prior, values, key)[0]) for f in (chosen, make("kalman"))]

    (mean, spread), (exact, exact_cov) = both(prior)
    np.testing.assert_allclose(mean, exact, rtol=1e-10)
    np.testing.assert_allclose(spread, exact_cov, rtol=1e-10, atol=1e-14)
