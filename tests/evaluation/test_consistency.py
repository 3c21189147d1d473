"""Oracles: published bounds, closed forms, error rates counted over many draws."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gammainc, ndtri, stdtrit

from kedge.core.errors import ConfigError, DataError
from kedge.evaluation.consistency import (
    chi_square_bound,
    chi_square_interval,
    consistency,
    coverage,
    mean_interval,
    nees,
    nis,
    whiteness,
)

seeds = st.integers(0, 2**32 - 1)


def draws(seed, count, size, factor=1.0):
    """Errors of covariance P, and `factor` times P."""
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, size, size)) + 2 * np.eye(size)
    errors = np.einsum("tij,tj->ti", roots, rng.normal(size=(count, size)))
    return errors, factor * roots @ roots.transpose(0, 2, 1)


def autoregressive(rng, correlation, shape):
    """Unit variance values whose autocorrelation at lag k is correlation**k."""
    values = rng.normal(size=shape)
    for t in range(1, shape[0]):
        values[t] = correlation * values[t - 1] + np.sqrt(1 - correlation**2) * values[t]
    return values


# Chi-square


@pytest.mark.parametrize(
    ("runs", "dof", "expected"),
    [
        (50, 2, (1.48444, 2.59122)),
        (50, 4, (3.25456, 4.82116)),
        (100, 6, (5.34019, 6.69769)),
        (50, 1, (0.64715, 1.42840)),
    ],
)
def test_bounds_of_averages_are_the_published_ones(runs, dof, expected):
    np.testing.assert_allclose(chi_square_interval(dof, runs), expected, atol=5e-6)


@given(probability=st.floats(0.001, 0.999))
def test_bounds_agree_with_the_closed_forms(probability):
    # One degree of freedom is a squared normal value, two are an exponential law.
    one, two = ndtri((1 + probability) / 2) ** 2, -2 * np.log(1 - probability)
    np.testing.assert_allclose(chi_square_bound(1, probability), one)
    np.testing.assert_allclose(chi_square_bound(2, probability), two)
    lower, upper = chi_square_interval(2, 1, probability)
    np.testing.assert_allclose(lower, -2 * np.log((1 + probability) / 2))
    np.testing.assert_allclose(upper, -2 * np.log((1 - probability) / 2))


@given(dof=st.integers(1, 20), runs=st.integers(1, 500), probability=st.floats(0.5, 0.999))
def test_the_interval_holds_its_probability_with_equal_tails(dof, runs, probability):
    bounds = np.array(chi_square_interval(dof, runs, probability))
    below = gammainc(dof * runs / 2, bounds * runs / 2)
    np.testing.assert_allclose(below, [(1 - probability) / 2, (1 + probability) / 2])


@pytest.mark.parametrize("probability", [0.0, 1.0, 95.0, float("nan")])
def test_a_probability_is_between_0_and_1(probability):
    with pytest.raises(ConfigError, match="between 0 and 1"):
        chi_square_bound(2, probability)
    with pytest.raises(ConfigError, match="between 0 and 1"):
        mean_interval(np.arange(5.0), probability)


# NEES and NIS


@given(seed=seeds, size=st.integers(1, 6))
def test_nees_is_the_same_in_any_coordinates(seed, size):
    # In the eigenvectors' frame the covariance is diagonal and NEES a sum of squares.
    error, cov = draws(seed, 8, size)
    variances, axes = np.linalg.eigh(cov)
    along = np.einsum("tij,ti->tj", axes, error)
    np.testing.assert_allclose(
        nees(error, cov), np.sum(along**2 / variances, axis=1), rtol=1e-8
    )


def test_nees_takes_any_batch_and_is_traceable():
    error, cov = draws(0, 12, 3)
    expected = np.asarray(nees(error, cov))
    batched = jax.jit(nees)(error.reshape(3, 4, 3), cov.reshape(3, 4, 3, 3))
    np.testing.assert_allclose(batched, expected.reshape(3, 4))
    np.testing.assert_allclose(jax.vmap(nees)(error, cov), expected)
    assert nees(error[0], cov[0]).shape == ()
    slope = jax.grad(lambda e: nees(e, cov[0]))(error[0])
    np.testing.assert_allclose(slope, 2 * np.linalg.solve(cov[0], error[0]))


def test_an_impossible_covariance_gives_nan():
    error, cov = np.ones((2, 2)), np.stack([np.eye(2), np.diag([1.0, -1.0])])
    np.testing.assert_array_equal(nees(error, cov), [2.0, np.nan])


@given(seed=seeds)
def test_nis_of_a_partial_reading_is_that_of_the_reduced_reading(seed):
    residual, cov = draws(seed, 8, 4)
    missing = np.random.default_rng([seed, 1]).random((8, 4)) < 0.5
    missing[0] = True
    found = np.asarray(nis(np.where(missing, np.nan, residual), cov))
    for t, gone in enumerate(missing):
        part, kept = residual[t][~gone], cov[t][np.ix_(~gone, ~gone)]
        reduced = part @ np.linalg.solve(kept, part) if part.size else np.nan
        np.testing.assert_allclose(found[t], reduced, rtol=1e-8)


# Verdicts


@pytest.mark.parametrize(
    ("factor", "verdict"), [(1.0, "consistent"), (0.7, "optimistic"), (1.4, "pessimistic")]
)
def test_the_verdict_tells_which_way_a_covariance_is_wrong(factor, verdict):
    found = consistency(np.asarray(nees(*draws(3, 200, 4, factor))), dof=4)
    assert found.verdict == verdict
    assert (found.lower, found.upper) == chi_square_interval(4, 200)
    assert found.size == 200


def test_the_rate_of_false_alarms_is_as_configured():
    values = np.asarray(nees(*draws(4, 20_000, 3))).reshape(1000, 20)
    alarms = sum(consistency(v, 3, probability=0.9).verdict != "consistent" for v in values)
    assert abs(alarms / 1000 - 0.1) < 4 * np.sqrt(0.09 / 1000)


def test_degrees_of_freedom_may_differ_by_value():
    values, dofs = np.array([1.0, 5.0, np.nan, 3.0]), np.array([1, 3, 0, 2])
    found = consistency(values, dofs)
    assert (found.average, found.size) == (3.0, 3)
    # Three values of two degrees of freedom each have the same sum of degrees.
    assert (found.lower, found.upper) == chi_square_interval(2, 3)
    assert consistency(values, 2).verdict == "not finite"
    with pytest.raises(DataError, match="no value"):
        consistency(values, np.zeros(4, dtype=int))


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_coverage_of_true_covariances_is_the_probability(probability):
    error, cov = draws(5, 10_000, 3)
    spread = np.sqrt(probability * (1 - probability) / 10_000)
    assert abs(coverage(error, cov, probability) - probability) < 4 * spread
    assert coverage(error, cov / 2, probability) < probability - 4 * spread


def test_failed_estimates_are_not_covered():
    error, cov = np.zeros((4, 2)), np.stack([np.eye(2)] * 4)
    error[0], cov[1] = np.nan, -np.eye(2)
    assert coverage(error, cov) == 0.5


# Whiteness


def test_without_gaps_the_statistic_is_that_of_ljung_and_box():
    values = np.random.default_rng(0).normal(size=(60, 1))
    found = whiteness(values, lags=5)
    x, n = values[:, 0].tolist(), 60
    power = sum(v * v for v in x)
    r = [sum(x[t] * x[t + k] for t in range(n - k)) / power for k in range(1, 6)]
    statistic = n * (n + 2) * sum(v * v / (n - k) for k, v in enumerate(r, start=1))
    np.testing.assert_allclose(found.statistic, statistic)
    np.testing.assert_allclose(found.p_value, 1 - gammainc(5 / 2, statistic / 2))
    pairs = 60 - np.arange(1, 6)
    np.testing.assert_allclose(found.autocorrelation, np.array(r) * 60 / pairs)
    np.testing.assert_array_equal(found.lag, [1, 2, 3, 4, 5])
    assert found.dof == 5


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_white_residuals_are_accepted_as_often_as_configured(missing):
    rng = np.random.default_rng(1)
    alarms, outside = 0, []
    for _ in range(1500):
        residuals = rng.normal(size=(150, 2)) * [1.0, 5.0]  # scale is no matter
        residuals[rng.random((150, 2)) < missing] = np.nan
        residuals[rng.random(150) < missing / 2] = np.nan
        found = whiteness(residuals, lags=8)
        alarms += not found.white
        outside.append(np.abs(found.autocorrelation) > found.band)
    assert abs(alarms / 1500 - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 1500)
    assert abs(np.mean(outside) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 12_000)


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_correlated_residuals_are_rejected(missing):
    rng = np.random.default_rng(2)
    residuals = autoregressive(rng, 0.6, (20_000, 2))
    residuals[rng.random((20_000, 2)) < missing] = np.nan
    found = whiteness(residuals, lags=5)
    np.testing.assert_allclose(found.autocorrelation, 0.6**found.lag, atol=0.04)
    assert not whiteness(residuals[:200], lags=5).white


def test_opposite_correlations_do_not_cancel():
    rng = np.random.default_rng(3)
    residuals = autoregressive(rng, 0.5, (1000, 2))
    residuals[:, 1] *= (-1.0) ** np.arange(1000)  # lag k becomes (-0.5)**k
    found = whiteness(residuals, lags=1)
    assert abs(found.autocorrelation[0]) < 2 * found.band[0]
    assert found.p_value < 1e-6


def test_a_bias_shows():
    assert not whiteness(np.random.default_rng(4).normal(0.5, 1, (500, 1)), lags=10).white


def test_a_lag_that_no_pair_has_is_not_counted():
    residuals = np.random.default_rng(5).normal(size=(400, 1))
    residuals[1::2] = np.nan
    found = whiteness(residuals, lags=4)
    np.testing.assert_array_equal(np.isnan(found.autocorrelation), [True, False, True, False])
    own = whiteness(residuals[::2], lags=2)
    np.testing.assert_allclose(found.autocorrelation[1::2], own.autocorrelation)
    np.testing.assert_allclose(found.band[1::2], own.band)
    assert found.dof == 2
    np.testing.assert_allclose(found.p_value, own.p_value)


def test_whiteness_refuses_what_it_cannot_judge():
    residuals = np.random.default_rng(6).normal(size=(20, 2))
    for lags in (0, 20):
        with pytest.raises(ConfigError, match="1 to 19"):
            whiteness(residuals, lags)
    sparse = np.full((20, 2), np.nan)
    sparse[[0, 19]] = 1.0
    with pytest.raises(DataError, match="one sensor"):
        whiteness(sparse, lags=4)
    for nothing in (0.0, np.nan):
        residuals[:, 1] = nothing
        with pytest.raises(DataError, match="component 1"):
            whiteness(residuals, lags=4)


# Interval of a mean


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_the_interval_of_a_mean_covers_as_often_as_configured(correlation, missing):
    rng = np.random.default_rng(7)
    values = 2 + autoregressive(rng, correlation, (2000, 400))
    values[rng.random(values.shape) < missing] = np.nan
    found = [mean_interval(v) for v in values.T]
    inside = np.mean([f.lower <= 2 <= f.upper for f in found])
    # Taking the values for independent would cover 34 % at a correlation of 0.9.
    assert abs(inside - 0.95) < 4 * np.sqrt(0.05 * 0.95 / 400)
    if not missing:
        effective = np.mean([f.effective_size for f in found])
        exact = 2000 * (1 - correlation) / (1 + correlation)
        np.testing.assert_allclose(effective, exact, rtol=0.15)


def test_the_error_of_a_mean_is_that_of_the_summed_autocovariances():
    values = autoregressive(np.random.default_rng(9), 0.97, (41, 1))[:, 0]
    d = (values - values.mean()).tolist()
    sums = [sum(d[t] * d[t + k] for t in range(41 - k)) for k in range(41)] + [0.0]
    couples, last = [], np.inf
    for even, odd in zip(sums[::2], sums[1::2], strict=True):
        if even + odd <= 0:
            break
        couples.append(last := min(last, even + odd))
    found = mean_interval(values)
    np.testing.assert_allclose(found.effective_size, 41 / (2 * sum(couples) / sums[0] - 1))
    np.testing.assert_allclose(found.std_error**2, sums[0] / 40 / found.effective_size)


def test_uncorrelated_values_have_the_textbook_interval():
    values = np.random.default_rng(11).normal(size=500)
    found = mean_interval(values, 0.9)
    half = stdtrit(499, 0.95) * np.std(values, ddof=1) / np.sqrt(500)
    np.testing.assert_allclose(found.upper - found.mean, half, rtol=0.15)
    np.testing.assert_allclose(found.mean - found.lower, found.upper - found.mean)
    np.testing.assert_allclose(found.mean, values.mean())


def test_negative_correlation_does_not_make_data():
    values = autoregressive(np.random.default_rng(8), -0.8, (500, 1))[:, 0]
    assert mean_interval(values).effective_size == 500


def test_a_constant_has_an_interval_of_no_width():
    assert mean_interval(np.ones(10)) == (1.0, 1.0, 1.0, 0.0, 10.0)


def test_one_value_has_no_interval():
    with pytest.raises(DataError, match="found 1"):
        mean_interval(np.array([1.0, np.nan]))
