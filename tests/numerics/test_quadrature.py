"""Points and weights against the moments of a standard normal."""

import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.numerics.quadrature import cubature, gauss_hermite, unscented

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


def moment(power):
    """Of a standard normal: 1, 0, 1, 0, 3, 0, 15, ..."""
    return 0 if power % 2 else np.prod(np.arange(1, power, 2))


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("order", [2, 3, 5])
def test_gauss_hermite_is_exact_to_its_degree_in_each_variable(size, order):
    points, weights, spread = gauss_hermite(size, order)
    assert len(points) == order**size + (order % 2 == 0)
    assert weights.min() >= 0
    np.testing.assert_array_equal(weights, spread)
    np.testing.assert_array_equal(points[0], 0)
    for powers in np.ndindex(*[2 * order] * size):
        values = np.prod(points ** np.array(powers), axis=1)
        expected = np.prod([moment(power) for power in powers])
        # Odd moments vanish by cancelling: rounding is that of the terms.
        rounding = 1e-13 * (weights @ np.abs(values))
        np.testing.assert_allclose(weights @ values, expected, atol=rounding, rtol=1e-12)


def test_a_grid_beyond_reason_is_refused():
    with pytest.raises(ContractError, match=r"order 3 in 15 variables.*14348907 points"):
        gauss_hermite(15)
    with pytest.raises(ContractError, match="order is 1, must be at least 2"):
        gauss_hermite(2, 1)


def test_cubature_weighs_all_points_alike():
    points, weights, _ = cubature(5)
    assert weights[0] == 0
    np.testing.assert_allclose(weights[1:], 0.1)
    np.testing.assert_allclose(np.linalg.norm(points[1:], axis=1), np.sqrt(5))


def test_points_that_would_be_imaginary_are_refused():
    with pytest.raises(
        ContractError, match=r"size 3.*is -1, must be > 0; found alpha=1, kappa=-4"
    ):
        unscented(3, kappa=-4.0)
