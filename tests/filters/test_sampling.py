"""Particles: what they report is what they carry. Ensembles: test_ensembles.py."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy

from kedge.core.beliefs import Gaussian, Particles
from kedge.core.errors import ContractError
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import State

PRIOR = Gaussian(
    State(jnp.array([1.0, 2.0]), jnp.array(0.0)), jnp.diag(jnp.array([4.0, 1.0, 0.01]))
)


def test_one_sample_is_no_sample():
    with pytest.raises(ContractError, match="count is 1, must be at least 2"):
        BootstrapParticle(count=1)


def test_samples_stand_for_the_prior(key):
    filter = BootstrapParticle(count=20_000)
    found = quick_jit(lambda key: filter.init(PRIOR, key).moments())(key)
    # The standard error of a variance is sqrt(2 / N) of it: 1 %.
    np.testing.assert_allclose(found.mean.position, [1, 2], atol=0.06)
    np.testing.assert_allclose(np.diag(found.cov), [4, 1, 0.01], rtol=0.05)


@pytest.fixture(scope="module")
def weigh():
    filter = BootstrapParticle(count=50)

    @quick_jit
    def run(place, threshold):
        belief = filter.init(PRIOR, jr.key(1))
        eager = BootstrapParticle(count=50, threshold=threshold)
        after, score = eager.update(Gnss(std=1.0), belief, Measurement(place), jr.key(2))
        return belief, after, score

    return run


def densities(belief, place):
    return scipy.stats.multivariate_normal([0, 0], np.eye(2)).pdf(
        np.asarray(belief.states.position) - place
    )


def test_weights_are_likelihoods(weigh):
    place = np.array([1.5, 2.5])
    before, after, score = weigh(place, 0.0)  # never resamples
    density = densities(before, place)
    np.testing.assert_allclose(np.exp(after.log_weights), density / density.sum(), rtol=1e-9)
    np.testing.assert_array_equal(after.states.position, before.states.position)
    # The evidence is the mean likelihood over the particles of the prior.
    np.testing.assert_allclose(score.log_likelihood, np.log(density.mean()), rtol=1e-9)


def test_resampling_copies_the_likely_and_levels_the_weights(weigh):
    place = np.array([1.5, 2.5])
    before, after, _ = weigh(place, 1.1)  # always resamples
    np.testing.assert_allclose(np.exp(after.log_weights), 1 / 50)
    density = densities(before, place)
    share = 50 * density / density.sum()
    old, new = (np.asarray(b.states.position)[:, 0] for b in (before, after))
    copies = np.array([(new == x).sum() for x in old])
    assert (np.abs(copies - share) < 1).all()
    assert copies.sum() == 50


def test_a_reading_that_no_particle_explains_is_refused(weigh):
    before, after, score = weigh(np.array([1e200, 0.0]), 0.5)
    assert not score.accepted
    np.testing.assert_array_equal(after.log_weights, before.log_weights)
    np.testing.assert_array_equal(after.states.position, before.states.position)


def test_unlikely_is_not_impossible(weigh):
    """Log weights throughout: 1e4 standard deviations away, one particle still carries all."""
    _, after, score = weigh(np.array([1e4, 0.0]), 0.0)
    assert score.accepted
    assert np.isfinite(score.log_likelihood)
    np.testing.assert_allclose(np.exp(after.log_weights).sum(), 1)


def test_weights_that_are_all_zero_say_so(key):
    """Law 11: a status, not a NaN."""
    nothing = Particles(State(jnp.zeros((50, 2)), jnp.zeros(50)), jnp.full(50, -jnp.inf))

    @quick_jit
    def update(belief):
        seen = Measurement(jnp.zeros(2))
        return BootstrapParticle(count=50).update(Gnss(std=1.0), belief, seen, key)

    after, score = update(nothing)
    assert not score.accepted
    assert not any(np.isnan(leaf).any() for leaf in jax.tree.leaves(after))
