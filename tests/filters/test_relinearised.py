"""Filters that linearise again, against the posterior by brute force."""

import functools as ft

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.registry import filters
from kedge.filters.gaussian.iterated import IteratedExtendedKalman
from kedge.filters.gaussian.posterior_linearisation import PosteriorLinearisation
from kedge.sensors.landmarks import Landmark, Landmarks, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import State

# A landmark near by, seen far from where it is expected: the extended filter's one step along
# the tangent ends beside the posterior.
STD = np.array([1.5, 1.0, 0.3])
SENSOR = Landmarks(
    range_std=0.2, bearing_std=0.1, target=Landmark(jnp.array([[2.0, 1.0]]))
).for_target(0)
SEEN = Measurement(jnp.array(4.0), jnp.array(1.5))
PRIOR = Gaussian(State(jnp.zeros(2), jnp.array(0.0)), jnp.diag(jnp.asarray(STD**2)))


@ft.cache
def posterior(filter):
    return quick_jit(lambda prior: filter.update(SENSOR, prior, SEEN, jax.random.key(0)))(PRIOR)


def cost(x):
    """Minus the log of the posterior density, without its constant; batched over rows."""
    away = np.array([2.0, 1.0]) - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    turn = np.angle(np.exp(1j * (1.5 - bearing)))
    distance = 4.0 - np.hypot(away[..., 0], away[..., 1])
    fit = (distance / 0.2) ** 2 + (turn / 0.1) ** 2
    return (fit + ((x / STD) ** 2).sum(axis=-1)) / 2


def state_of(belief):
    mean = belief.moments().mean
    return np.array([*mean.position, mean.heading])


def test_the_iterated_filter_ends_at_the_most_probable_state():
    found = state_of(posterior(IteratedExtendedKalman(iterations=12))[0])
    # No direction leads down from there.
    steps = 1e-3 * np.concatenate([np.eye(3), -np.eye(3)])
    assert (cost(found + steps) > cost(found)).all()
    assert cost(found) < cost(state_of(posterior(filters.make("extended"))[0])) - 1


@pytest.mark.slow
def test_without_halvings_one_iteration_is_the_plain_filter():
    pairs = {
        "extended": IteratedExtendedKalman(iterations=1, halvings=0),
        "cubature": PosteriorLinearisation(iterations=1, halvings=0),
        "unscented": PosteriorLinearisation(rule="unscented", iterations=1, halvings=0),
        "gauss-hermite": PosteriorLinearisation("gauss-hermite", iterations=1, halvings=0),
    }
    for name, filter in pairs.items():
        plain, score = posterior(filters.make(name))
        belief, own = posterior(filter)
        np.testing.assert_allclose(state_of(belief), state_of(plain), rtol=1e-9)
        np.testing.assert_allclose(belief.cov, plain.cov, rtol=1e-9, atol=1e-12)
        for name in ("residual", "cov", "nis", "log_likelihood"):
            np.testing.assert_allclose(getattr(own, name), getattr(score, name), rtol=1e-9)


@pytest.mark.slow
def test_posterior_linearisation_is_nearest_to_the_true_moments():
    """Mean and covariance by importance sampling from the most probable state's Gaussian."""
    best, _ = posterior(IteratedExtendedKalman(iterations=12))
    random, centre = np.random.default_rng(0), state_of(best)
    root = np.linalg.cholesky(3 * np.asarray(best.cov))
    white = random.normal(size=(400_000, 3))
    points = centre + white @ root.T
    log_weights = -cost(points) + (white**2).sum(axis=1) / 2
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    assert 1 / (weights**2).sum() > 10_000
    mean = weights @ points

    def distance(filter):
        belief = posterior(filter)[0]
        gap = state_of(belief) - mean
        return gap @ np.linalg.solve(best.cov, gap)

    plain, again = (distance(filters.make(n)) for n in ("cubature", "posterior-linearisation"))
    assert again < plain / 10


def test_the_innovation_is_that_of_the_prior():
    _, score = posterior(IteratedExtendedKalman(iterations=12))
    _, first = posterior(filters.make("extended"))
    np.testing.assert_allclose(score.nis, first.nis, rtol=1e-9)
    np.testing.assert_allclose(score.log_likelihood, first.log_likelihood, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("iterated", {"iterations": 0}, "iterated: iterations is 0, must be at least 1"),
        ("iterated", {"halvings": -1}, "iterated: halvings is -1, must be at least 0"),
        (
            "posterior-linearisation",
            {"rule": "simpson"},
            "rule is 'simpson', must be one of cubature, gauss-hermite, unscented",
        ),
        ("gauss-hermite", {"order": 1}, "order is 1, must be at least 2"),
    ],
)
def test_bad_parameters_are_refused(name, parameters, message):
    with pytest.raises(ContractError, match=message):
        filters.make(name, **parameters)
