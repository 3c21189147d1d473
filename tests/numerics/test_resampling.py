"""Weights in logarithms, their effective size, and what no scheme may do."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.numerics.resampling import SCHEMES, effective_sample_size, normalised
from kedge.testing import quick_jit

COUNT = 40
EXTREME = np.linspace(-1e4, 0, COUNT)
HOPELESS = np.full(COUNT, -np.inf)

size = quick_jit(effective_sample_size)


def test_effective_size_counts_what_is_equal():
    for used in (1, 7, COUNT):
        weights = np.where(np.arange(COUNT) < used, 3.0, 0.0)
        with np.errstate(divide="ignore"):
            np.testing.assert_allclose(size(np.log(weights)), used)


def test_extreme_weights_give_no_nan():
    np.testing.assert_allclose(size(EXTREME), 1, rtol=1e-12)
    shares, total = normalised(jnp.asarray(EXTREME))
    np.testing.assert_allclose(np.exp(shares).sum(), 1, rtol=1e-14)
    np.testing.assert_allclose(total, 0, atol=1e-12)


def test_no_weight_at_all_is_a_size_of_none():
    assert size(HOPELESS) == 0
    shares, total = normalised(jnp.asarray(HOPELESS))
    assert total == -np.inf
    np.testing.assert_allclose(np.exp(shares), 1 / COUNT)


def test_a_weight_that_is_no_number_is_none():
    shares, total = normalised(jnp.array([0.0, jnp.nan, 0.0]))
    np.testing.assert_allclose(np.exp(shares), [0.5, 0, 0.5])
    np.testing.assert_allclose(total, np.log(2))


@pytest.mark.parametrize("name", SCHEMES)
def test_every_scheme_names_particles_that_exist(name):
    scheme = quick_jit(SCHEMES[name])
    for weights, allowed in (
        (EXTREME, [COUNT - 1]),
        (HOPELESS, range(COUNT)),
        (np.where(np.arange(COUNT) == 0, 0.0, -np.inf), [0]),
        (np.where(np.arange(COUNT) == 17, 700.0, -np.inf), [17]),
    ):
        chosen = np.asarray(scheme(jr.key(3), weights))
        assert chosen.shape == (COUNT,)
        assert np.isin(chosen, allowed).all()


@pytest.mark.parametrize("name", SCHEMES)
def test_single_precision_stays_single(name):
    weights = jnp.linspace(-3, 0, 1000, dtype=jnp.float32)
    chosen = np.asarray(quick_jit(SCHEMES[name])(jr.key(4), weights))
    counts = np.bincount(chosen, minlength=1000)
    share = 1000 * np.exp(np.linspace(-3, 0, 1000)) / np.exp(np.linspace(-3, 0, 1000)).sum()
    assert normalised(weights)[0].dtype == jnp.float32
    # Sums over blocks of a hundred: five binomial standard deviations at the most.
    gap = (counts - share).reshape(10, 100).sum(axis=1)
    assert (np.abs(gap) < 5 * np.sqrt(share.reshape(10, 100).sum(axis=1))).all()


def test_equal_weights_are_left_alone():
    for name in ("systematic", "stratified", "residual"):
        chosen = quick_jit(SCHEMES[name])(jr.key(5), jnp.full(COUNT, -7.3))
        np.testing.assert_array_equal(np.bincount(chosen, minlength=COUNT), 1)
