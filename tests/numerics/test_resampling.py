"""Resampling keeps every weight's share."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from kedge.numerics.resampling import effective_sample_size, systematic
from kedge.testing import quick_jit

COUNT = 40
RANDOM = np.random.default_rng(0)
# Even, uneven, hopeless: one particle that carries all, and many that carry nothing.
WEIGHTS = np.concatenate(
    [
        np.full((1, COUNT), 1 / COUNT),
        RANDOM.dirichlet(np.ones(COUNT), size=20),
        RANDOM.dirichlet(np.full(COUNT, 0.05), size=20),
        np.eye(COUNT)[[0, 17, COUNT - 1]],
    ]
)


def counts(chosen):
    return np.stack([np.bincount(row, minlength=COUNT) for row in np.asarray(chosen)])


def test_systematic_gives_each_its_share_rounded_down_or_up():
    chosen = quick_jit(jax.vmap(systematic))(jr.split(jr.key(0), len(WEIGHTS)), WEIGHTS)
    found, share = counts(chosen), COUNT * WEIGHTS
    # Where the share is whole, rounding of the sum may take it either way.
    assert (found >= np.floor(share - 1e-9)).all()
    assert (found <= np.ceil(share + 1e-9)).all()
    assert (found.sum(axis=1) == COUNT).all()
    assert (found[WEIGHTS == 0] == 0).all()


def test_systematic_is_unbiased():
    weights, runs = WEIGHTS[1], 4000
    chosen = quick_jit(jax.vmap(systematic, (0, None)))(jr.split(jr.key(1), runs), weights)
    mean, share = counts(chosen).mean(axis=0), COUNT * weights
    fraction = share - np.floor(share)
    std = np.sqrt(fraction * (1 - fraction) / runs)
    assert (np.abs(mean - share) <= 4.5 * std + 1e-12).all()


def test_effective_size_counts_what_is_equal():
    size = quick_jit(effective_sample_size)
    for used in (1, 7, COUNT):
        weights = np.where(np.arange(COUNT) < used, 1 / used, 0.0)
        with np.errstate(divide="ignore"):
            np.testing.assert_allclose(size(np.log(weights)), used)


def test_extreme_weights_give_no_nan():
    log_weights = jnp.linspace(-1e4, 0, COUNT) - jax.nn.logsumexp(jnp.linspace(-1e4, 0, COUNT))
    np.testing.assert_allclose(effective_sample_size(log_weights), 1, rtol=1e-12)
