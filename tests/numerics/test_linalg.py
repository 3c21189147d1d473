"""Factorisations and solves against numpy, unrolled and beyond."""

import functools as ft

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.numerics.linalg import (
    UNROLLED,
    cholesky,
    definite,
    gain,
    solve_lower,
    solve_lower_transposed,
    square_root,
    symmetric,
    triangularise,
)
from kedge.testing import quick_jit

SIZES = range(1, UNROLLED + 2)
RANDOM = np.random.default_rng(0)


def positive_definite(size):
    factor = RANDOM.normal(size=(size, size))
    # Scales from 1e-3 to 1e3: nothing may depend on units.
    scale = np.diag(10 ** np.linspace(-3, 3, size))
    return scale @ (factor @ factor.T + 0.1 * np.eye(size)) @ scale


COVS = {size: positive_definite(size) for size in SIZES}
RIGHTS = {size: RANDOM.normal(size=(size, 2)) for size in SIZES}


@ft.cache
def found(size):
    @quick_jit
    def every(cov, right):
        root = cholesky(cov)
        solved = solve_lower(root, right), solve_lower_transposed(root, right)
        return root, square_root(cov), *solved

    return every(COVS[size], RIGHTS[size])


@pytest.mark.parametrize("size", SIZES)
def test_factor_is_that_of_numpy(size):
    expected = np.linalg.cholesky(COVS[size])
    for root in found(size)[:2]:
        np.testing.assert_allclose(root, expected, rtol=1e-11)


@pytest.mark.parametrize("size", SIZES)
def test_solutions_solve(size):
    root, right = np.linalg.cholesky(COVS[size]), RIGHTS[size]
    for transposed, solution in zip((root, root.T), found(size)[2:], strict=True):
        np.testing.assert_allclose(solution, np.linalg.solve(transposed, right), rtol=1e-9)


def test_gain_solves_from_the_right():
    cov, cross = COVS[3], RIGHTS[3].T
    found = quick_jit(lambda cov: gain(jnp.asarray(cross), cholesky(cov)))(cov)
    np.testing.assert_allclose(found, np.linalg.solve(cov, cross.T).T, rtol=1e-9)


def test_a_vector_is_solved_as_a_column_is():
    root, right = np.linalg.cholesky(COVS[3]), RIGHTS[3][:, 0]
    np.testing.assert_allclose(
        quick_jit(solve_lower)(root, right), np.linalg.solve(root, right)
    )


@pytest.fixture(scope="module", params=[4, UNROLLED + 1])
def spoilt(request):
    """A factoriser of matrices of one size, for what is not positive definite."""
    size = request.param
    both = quick_jit(lambda matrix: (cholesky(matrix), square_root(matrix)))
    return size, lambda matrix: jax.tree.map(np.asarray, both(matrix))


def test_what_is_indefinite_has_no_factor(spoilt):
    size, both = spoilt
    matrix = np.eye(size)
    matrix[1, 1] = -1e-3
    for root in both(matrix):
        assert np.isnan(root).any()


def test_what_is_semidefinite_has_a_square_root(spoilt):
    """Rank 2: rounding leaves pivots of either sign where exact arithmetic has zeros."""
    size, both = spoilt
    for seed in range(20):
        factor = np.random.default_rng(seed).normal(size=(size, 2)) * [10, 0.1]
        root = both(factor @ factor.T)[1]
        np.testing.assert_allclose(root @ root.T, factor @ factor.T, atol=1e-11)
        np.testing.assert_array_equal(np.triu(root, 1), 0)


def test_what_is_known_exactly_does_not_spread(spoilt):
    size, both = spoilt
    variances = np.arange(size, dtype=float)
    root = both(np.diag(variances))[1]
    np.testing.assert_allclose(root, np.diag(np.sqrt(variances)), rtol=1e-15)
    np.testing.assert_array_equal(root == 0, np.diag(variances) == 0)
    np.testing.assert_array_equal(both(np.zeros((size, size)))[1], 0)


@pytest.mark.parametrize("size", [4, UNROLLED + 1])
def test_a_variance_of_zero_has_a_finite_derivative(size):
    """Of the root's squares, which are the variances: one where there is one, else nothing."""
    known = np.diag([1.0] * (size - 1) + [0.0])
    slope = quick_jit(jax.grad(lambda matrix: jnp.sum(square_root(matrix) ** 2)))(known)
    np.testing.assert_allclose(np.diag(slope), np.diag(known), atol=1e-12)


def test_what_is_not_finite_stays_so(spoilt):
    size, both = spoilt
    matrix = np.eye(size)
    matrix[0, 0] = np.nan
    for root in both(matrix):
        assert np.isnan(root).any()


@pytest.mark.parametrize("size", [2, 5, 2 * UNROLLED, 2 * UNROLLED + 1])
def test_triangularised_rows_have_the_same_products(size):
    """Of full rank, and of rank 1, where a Cholesky factor of the product has no pivots."""
    for rows in (RANDOM.normal(size=(size, size + 3)), np.vander(np.ones(size), 2) @ np.eye(2)):
        root = np.asarray(quick_jit(triangularise)(jnp.asarray(rows)))
        np.testing.assert_array_equal(np.triu(root, 1), 0)
        assert (np.diag(root) >= 0).all()
        np.testing.assert_allclose(root @ root.T, rows @ rows.T, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("size", [4, UNROLLED + 1, 33])
def test_what_is_indefinite_is_mended_and_counted(size):
    repair = quick_jit(definite)
    matrix = np.diag(np.arange(1.0, size + 1))
    matrix[1, 1] = -1e-3
    matrix[0, 2] = matrix[2, 0] = 0.5
    mended, lifted = repair(matrix)
    assert lifted == 1
    matrix[1, 1] = 0.0
    np.testing.assert_allclose(mended, matrix, atol=1e-15)
    for sound in (np.eye(size), matrix, np.zeros((size, size))):
        mended, lifted = repair(sound)
        assert lifted == 0
        np.testing.assert_array_equal(mended, sound)
    matrix[0, 0] = np.nan
    mended, lifted = repair(matrix)
    assert lifted == 0
    assert np.isnan(mended[0, 0])


def test_symmetric_keeps_the_quadratic_form():
    matrix, vector = RANDOM.normal(size=(4, 4)), RANDOM.normal(size=4)
    even = np.asarray(symmetric(jnp.asarray(matrix)))
    np.testing.assert_array_equal(even, even.T)
    np.testing.assert_allclose(vector @ even @ vector, vector @ matrix @ vector)
