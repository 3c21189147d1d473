"""Functions of a Gram matrix: the same in whichever space they are decomposed."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from kedge.numerics.gram import gram
from kedge.testing import quick_jit


@pytest.mark.parametrize("shape", [(3, 7), (7, 3), (5, 5)])
def test_symmetric_root_and_pull(shape):
    rng = np.random.default_rng(1)
    factor, columns = rng.normal(size=shape), rng.normal(size=(9, shape[1]))
    left = rng.normal(size=(2, shape[0]))
    square = factor.T @ factor

    def both(factor):
        found = gram(factor)
        root = found.applied(
            lambda v: jnp.sqrt(1 + v), lambda v: 1 / (1 + jnp.sqrt(1 + v)), jnp.asarray(columns)
        )
        return root, found.pulled(lambda v: 1 / (1 + v), jnp.asarray(left))

    root, pulled = quick_jit(both)(factor)
    expected = columns @ scipy.linalg.sqrtm(np.eye(shape[1]) + square)
    np.testing.assert_allclose(root, expected, atol=1e-12)
    expected = left @ factor @ np.linalg.inv(np.eye(shape[1]) + square)
    np.testing.assert_allclose(pulled, expected, atol=1e-12)


def test_rank_counts_what_is_there():
    factor = np.outer([1.0, 2.0, -3.0], [1.0, 1.0])
    assert quick_jit(lambda y: gram(y).rank().sum())(factor) == 1
    assert quick_jit(lambda y: gram(y).rank().sum())(np.zeros((3, 5))) == 0
