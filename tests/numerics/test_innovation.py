"""The score of a residual against scipy's multivariate normal."""

import numpy as np
import pytest
import scipy

from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky
from kedge.testing import quick_jit

RANDOM = np.random.default_rng(0)
score = quick_jit(lambda residual, cov, dof: innovation(residual, cov, cholesky(cov), dof))


@pytest.mark.parametrize("size", [1, 3])
def test_likelihood_and_nis_are_those_of_the_normal_density(size):
    factor, residual = RANDOM.normal(size=(size, size + 2)), RANDOM.normal(size=size)
    cov = factor @ factor.T
    found = score(residual, cov, size)
    expected = scipy.stats.multivariate_normal(np.zeros(size), cov).logpdf(residual)
    np.testing.assert_allclose(found.log_likelihood, expected)
    np.testing.assert_allclose(found.nis, residual @ np.linalg.inv(cov) @ residual)
    assert bool(found.accepted)


def test_a_missing_component_scores_nothing():
    """Residual 0, unit variance, one degree of freedom less: the density of the other one."""
    found = score(np.array([0.7, 0.0]), np.diag([0.3, 1.0]), 1)
    expected = scipy.stats.norm(0, 0.3**0.5).logpdf(0.7)
    np.testing.assert_allclose(found.log_likelihood, expected)
    np.testing.assert_allclose(found.nis, 0.49 / 0.3)
