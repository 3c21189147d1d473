"""Points and weights against the moments of a standard normal."""

import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.numerics.quadrature import unscented

RULES = [{}, {"alpha": 1e-3, "beta": 2.0, "kappa": 0.0}, {"kappa": -0.5}, {"alpha": 0.5}]


@pytest.mark.parametrize("size", [1, 3, 8])
@pytest.mark.parametrize("parameters", RULES)
def test_exact_to_third_order(size, parameters):
    points, weights, spread = unscented(size, **parameters)
    tolerance = 1e-15 * np.abs(weights).max() * 10
    np.testing.assert_allclose(weights.sum(), 1, atol=tolerance)
    np.testing.assert_allclose(weights @ points, 0, atol=tolerance)
    second = np.einsum("k,ki,kj->ij", weights, points, points)
    np.testing.assert_allclose(second, np.eye(size), atol=tolerance)
    third = np.einsum("k,ki,kj,kl->ijl", weights, points, points, points)
    np.testing.assert_allclose(third, 0, atol=tolerance)
    # The centre's own weight enters covariances only where the error is not zero.
    np.testing.assert_array_equal(points[0], 0)
    np.testing.assert_array_equal(weights[1:], spread[1:])


@pytest.mark.parametrize("size", [1, 2, 5])
def test_default_weights_are_not_negative(size):
    assert unscented(size).mean_weights.min() >= 0
    assert unscented(size).cov_weights.min() >= 0


def test_kappa_fits_the_fourth_moment_of_one_variable():
    """n + kappa = 3 (Julier and Uhlmann, 2004, section III)."""
    points, weights, _ = unscented(1, kappa=2.0)
    np.testing.assert_allclose(weights @ points[:, 0] ** 4, 3)


def test_the_scaled_rule_adds_its_correction_at_the_centre():
    """W0c = W0m + 1 - alpha^2 + beta (Julier, 2002): -1e6 or so for the usual parameters."""
    _, mean, cov = unscented(3, alpha=1e-3, beta=2.0, kappa=0.0)
    np.testing.assert_allclose(mean[0], 1 - 1e6)
    np.testing.assert_allclose(cov[0] - mean[0], 3 - 1e-6)


def test_points_that_would_be_imaginary_are_refused():
    with pytest.raises(
        ContractError, match=r"size 3.*is -1, must be > 0; found alpha=1, kappa=-4"
    ):
        unscented(3, kappa=-4.0)
