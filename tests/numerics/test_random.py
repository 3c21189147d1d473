"""Cheap normal draws: the generator bit for bit, the transform by its functions, the law."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax.extend.random import threefry_2x32

from kedge.numerics.random import _log_unit, _turned, fold_in, normals, split, threefry

ZERO = jnp.zeros((), jnp.uint32)
WORDS = np.append(
    np.random.default_rng(0).integers(0, 2**32, 10_000, dtype=np.uint32),
    np.array([0, 1, 2, 2**30, 2**31, 2**31 - 1, 2**32 - 1], np.uint32),
)


def test_the_generator_is_that_of_jax():
    key, words = jr.key_data(jr.key(7)), jnp.asarray(WORDS)
    ours = threefry(key, words, words[::-1])
    theirs = threefry_2x32(key, jnp.concatenate([words, words[::-1]]))
    np.testing.assert_array_equal(jnp.concatenate(ours), theirs)


def test_logarithm_and_cosine():
    words = jnp.asarray(WORDS)
    found = np.asarray(_log_unit(words, ZERO), float)
    expected = np.log((WORDS // 2 + 0.25) / 2**31)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    angle = 2 * np.pi * WORDS / 2**32 - np.pi / 4
    np.testing.assert_allclose(_turned(words, ZERO), [np.cos(angle), np.sin(angle)], atol=1e-6)


def test_keys_are_those_of_jax():
    key = jr.key(7)

    def data(keys):
        return np.asarray(jr.key_data(keys))

    for number in (0, 5, 2**32 - 1):
        np.testing.assert_array_equal(data(fold_in(key, number)), data(jr.fold_in(key, number)))
    np.testing.assert_array_equal(data(split(key, 5)), data(jr.split(key, 5)))
    many = jr.split(key, 3)
    numbers = jnp.arange(3)
    for ours, theirs in (
        (fold_in, jr.fold_in),
        (lambda k, _: split(k), lambda k, _: jr.split(k)),
    ):
        np.testing.assert_array_equal(
            data(jax.vmap(ours)(many, numbers)), data(jax.vmap(theirs)(many, numbers))
        )
    other = jr.key(3, impl="rbg")
    np.testing.assert_array_equal(data(fold_in(other, 2)), data(jr.fold_in(other, 2)))
    np.testing.assert_array_equal(data(split(other)), data(jr.split(other)))


def test_the_law():
    """Moments, tails, independence of neighbours and of the two numbers of a pair."""
    from scipy import stats

    count = 400_000
    z = np.asarray(normals(jr.key(1), (count,)))
    # Standard errors of the mean, variance, skewness and kurtosis: five of each are allowed.
    for found, variance in (
        (z.mean(), 1),
        (z.var() - 1, 2),
        (stats.skew(z), 6),
        (stats.kurtosis(z), 24),
    ):
        assert abs(found) < 5 * np.sqrt(variance / count)
    assert stats.kstest(z, "norm").pvalue > 1e-4
    for bound in (3.0, 4.0):
        expected = count * 2 * stats.norm.sf(bound)
        assert abs(np.sum(np.abs(z) > bound) - expected) < 5 * np.sqrt(expected)
    half = count // 2
    pairs = ((z[::2], z[1::2]), (z[::2] ** 2, z[1::2] ** 2), (z[:half], z[half:]))
    for left, right in ((z[:-1], z[1:]), *pairs):
        assert abs(np.corrcoef(left, right)[0, 1]) < 5 / np.sqrt(len(left))


def test_keys_shapes_and_batches():
    keys = jr.split(jr.key(5), 3)
    together = jax.vmap(lambda key: normals(key, (5, 3)))(keys)
    alone = jnp.stack([normals(key, (5, 3)) for key in keys])
    np.testing.assert_array_equal(together, alone)
    assert len(np.unique(together)) == together.size
    assert normals(keys[0], (), jnp.float32).dtype == jnp.float32
    assert normals(keys[0], (0, 4)).shape == (0, 4)


def test_another_generator_is_used_as_it_is():
    key = jr.key(3, impl="rbg")
    np.testing.assert_array_equal(normals(key, (4,)), jr.normal(key, (4,)))


def test_bits_hang_on_no_compiler(key):
    """Whether products and sums are rounded together differs from program to program."""

    def draw(key):
        return normals(key, (37,))

    keys = split(key, 50)
    looped = jax.jit(lambda keys: jax.lax.map(draw, keys))(keys)
    alone = jax.jit(draw)
    np.testing.assert_array_equal(looped, [alone(one) for one in keys])
