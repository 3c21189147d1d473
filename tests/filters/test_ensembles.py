"""Ensemble filters: what they report is what they carry; options do what they say."""

import math

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Ensemble, Gaussian
from kedge.core.errors import ContractError
from kedge.core.registry import filters
from kedge.filters.ensemble.enkf_n import FiniteSizeEnsembleKalman
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.numerics.ensemble import rotation
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import State

NAMES = [
    name for name in filters.names() if issubclass(filters.get(name), AbstractEnsembleFilter)
]
PRIOR = Gaussian(
    State(jnp.array([1.0, 2.0]), jnp.array(0.0)), jnp.diag(jnp.array([4.0, 1.0, 0.01]))
)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"count": 1}, "count is 1, must be at least 2"),
        ({"inflation": 0.0}, "inflation is 0, must be above 0"),
        ({"inflation": math.nan}, "inflation is nan, must be above 0"),
        ({"radius": -1.0}, "radius is -1, must be above 0"),
        ({"noise": "sample"}, "no noise called 'sample' .did you mean 'sampled'"),
    ],
)
def test_bad_parameters_are_named(name, bad, says):
    with pytest.raises(ContractError, match=says):
        filters.make(name, **bad)


def test_certainty_is_positive():
    with pytest.raises(ContractError, match="certainty is 0, must be above 0"):
        FiniteSizeEnsembleKalman(certainty=0.0)


@pytest.mark.parametrize("name", NAMES)
def test_a_radius_needs_distances(name, key):
    filter = filters.make(name, count=5, radius=10.0)
    with pytest.raises(ContractError, match="radius is 10, but Gnss has no distances"):
        jax.eval_shape(
            lambda key: filter.update(
                Gnss(), filter.init(PRIOR, key), Measurement(jnp.zeros(2)), key
            ),
            key,
        )


def test_members_stand_for_the_prior(key):
    filter = EnsembleKalman(count=20_000)
    found = quick_jit(lambda key: filter.init(PRIOR, key).moments())(key)
    # The standard error of a variance is sqrt(2 / N) of it: 1 %.
    np.testing.assert_allclose(found.mean.position, [1, 2], atol=0.06)
    np.testing.assert_allclose(np.diag(found.cov), [4, 1, 0.01], rtol=0.05)


def test_the_ensemble_moves_by_the_gain_of_its_own_sample(key):
    """With an exact sensor, all members agree with the reading and their spread is gone."""
    filter = EnsembleKalman(count=30)

    @quick_jit
    def update(key):
        belief = filter.init(PRIOR, key)
        after, score = filter.update(
            Gnss(std=1e-9), belief, Measurement(jnp.array([3.0, 0.0])), key
        )
        return belief, after, score

    before, after, score = update(key)
    np.testing.assert_allclose(after.members.position, np.tile([3.0, 0.0], (30, 1)), atol=1e-6)
    # What the innovation says of the spread is the sample covariance of what was expected.
    np.testing.assert_allclose(
        score.cov, np.cov(np.asarray(before.members.position).T), rtol=1e-9
    )
    # The heading follows by its sample correlation with the position, which is not quite zero.
    sample = np.cov(np.column_stack([before.members.position, before.members.heading]).T)
    slope = np.linalg.solve(sample[:2, :2], sample[:2, 2])
    shift = np.asarray(after.members.heading - before.members.heading)
    expected = (np.array([3.0, 0.0]) - np.asarray(before.members.position)) @ slope
    np.testing.assert_allclose(shift, expected, atol=1e-6)


def test_centred_perturbations_leave_the_mean_to_the_reading(key):
    """The mean is the Kalman filter's with them, and scatters about it without."""

    def update(key, centred):
        filter = EnsembleKalman(count=12, centred=centred)
        belief = filter.init(PRIOR, jr.key(1))
        reading = Measurement(jnp.array([2.0, 2.0]))
        return filter.update(Gnss(), belief, reading, key)[0].moments()

    keys = jr.split(key, 4000)
    centred, free = (
        quick_jit(jax.vmap(lambda key, c=c: update(key, c)))(keys) for c in (True, False)
    )
    assert np.ptp(centred.mean.position, axis=0).max() < 1e-12
    assert np.ptp(free.mean.position, axis=0).min() > 0.1
    np.testing.assert_allclose(free.mean.position.mean(0), centred.mean.position[0], atol=0.02)
    # The covariance has the same expectation: the Kalman filter's, of these members.
    before = np.asarray(EnsembleKalman(count=12).init(PRIOR, jr.key(1)).moments().cov)
    gain = before[:, :2] @ np.linalg.inv(before[:2, :2] + np.eye(2))
    expected = before - gain @ before[:2]
    for found in (centred, free):
        cov = np.asarray(found.cov)
        error = cov.std(axis=0) / len(keys) ** 0.5
        assert np.all(np.abs(cov.mean(axis=0) - expected) < 5 * error)


def test_inflation_stretches_the_anomalies_that_are_reported(key):
    def update(inflation):
        filter = filters.make("etkf", count=9, inflation=inflation)
        belief = filter.init(PRIOR, key)
        return filter.update(Gnss(), belief, Measurement(jnp.ones(2)), key)[0]

    found = quick_jit(jax.vmap(update))(jnp.array([1.0, 1.5]))
    plain, wide = np.asarray(found.members.position)
    np.testing.assert_allclose(wide - wide.mean(0), 1.5 * (plain - plain.mean(0)), atol=1e-12)
    np.testing.assert_allclose(wide.mean(0), plain.mean(0), atol=1e-12)


@pytest.mark.parametrize("count", [2, 5, 24])
def test_rotations_keep_the_mean_and_are_orthogonal(count, key):
    found = quick_jit(jax.vmap(lambda key: rotation(key, count, float)))(jr.split(key, 2000))
    np.testing.assert_allclose(found[0] @ found[0].T, np.eye(count), atol=1e-12)
    np.testing.assert_allclose(found[0].sum(axis=1), 1, atol=1e-12)
    # Uniform on what leaves the ones in place: on average, the projection on them.
    np.testing.assert_allclose(found.mean(axis=0), 1 / count, atol=5 / 2000**0.5)


@pytest.mark.parametrize("name", NAMES)
def test_headings_at_the_seam_move_together(name, key):
    """Members on both sides of half a turn, updated by a position that they correlate with."""
    rng = np.random.default_rng(3)
    offsets = rng.normal(size=(20, 2)) * [1.0, 0.3]
    offsets = offsets - offsets.mean(axis=0)

    def posterior(centre):
        turned = jnp.asarray(centre + offsets[:, 1] + 0.2 * offsets[:, 0])
        heading = jnp.arctan2(jnp.sin(turned), jnp.cos(turned))
        place = jnp.stack([jnp.asarray(offsets[:, 0]), jnp.zeros(20)], axis=1)
        filter, belief = filters.make(name, count=20), Ensemble.of(State(place, heading))
        reading = Measurement(jnp.array([1.0, 0.0]))
        moments = filter.update(Gnss(std=0.5), belief, reading, key)[0].moments()
        return moments.mean.heading - centre, moments.cov

    at_zero, cov = quick_jit(posterior)(0.0)
    at_seam, other = quick_jit(posterior)(math.pi)
    turn = (at_seam - at_zero + math.pi) % (2 * math.pi) - math.pi
    np.testing.assert_allclose(turn, 0, atol=1e-9)
    np.testing.assert_allclose(cov, other, atol=1e-9)
    assert at_zero > 0.05
