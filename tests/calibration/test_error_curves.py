"""Error curves: their parameters come back, and the right family is chosen."""

import numpy as np
import pytest
from scipy.optimize import curve_fit

from kedge.calibration.error_curves import FAMILIES, choose_curve, fit_curve
from kedge.calibration.histogram import fit_histogram
from kedge.core.errors import DataError

RNG = np.random.default_rng(7)
DRAWS = {
    "normal": (RNG.normal(0.114, 0.145, 3000), {"mean": 0.114, "std": 0.145}),
    "exponential": (0.2 + RNG.exponential(0.5, 3000), {"shift": 0.2, "scale": 0.5}),
    "gamma": (RNG.gamma(3.0, 0.1, 3000), {"shape": 3.0, "scale": 0.1}),
    "emg": (
        RNG.normal(0.05, 0.03, 3000) + RNG.exponential(0.2, 3000),
        {"mean": 0.05, "std": 0.03, "tail": 0.2},
    ),
    "mixture": (
        np.where(RNG.random(3000) < 0.3, RNG.normal(0.9, 0.2, 3000), RNG.normal(0, 0.05, 3000)),
        {"mean": 0.0, "std": 0.05, "blocked_mean": 0.9, "blocked_std": 0.2, "share": 0.3},
    ),
}


@pytest.mark.parametrize("family", list(FAMILIES))
def test_parameters_come_back_and_the_family_is_chosen(family):
    errors, truth = DRAWS[family]
    curves = choose_curve(errors)
    assert curves[0].family == family
    assert curves[0].mean == pytest.approx(errors.mean(), abs=0.01)
    assert curves[0].std == pytest.approx(errors.std(), rel=0.05)
    for name, value in truth.items():
        gap = abs(curves[0].parameters[name] - value)
        assert gap < 4 * curves[0].std_errors[name], name
    grid = np.linspace(-3, 8, 200001)
    assert np.sum(curves[0].density(grid)) * (grid[1] - grid[0]) == pytest.approx(1, abs=1e-3)


def test_densities_are_those_of_scipy():
    import scipy.stats

    x = np.linspace(0.01, 2.0, 50)
    for family, parameters, other in (
        ("gamma", {"shape": 3.0, "scale": 0.1}, scipy.stats.gamma(3.0, scale=0.1)),
        (
            "emg",
            {"mean": 0.05, "std": 0.03, "tail": 0.2},
            scipy.stats.exponnorm(0.2 / 0.03, loc=0.05, scale=0.03),
        ),
        ("exponential", {"shift": 0.005, "scale": 0.5}, scipy.stats.expon(0.005, 0.5)),
    ):
        found = FAMILIES[family].log_density(x, **parameters)
        np.testing.assert_allclose(found, other.logpdf(x), rtol=1e-6, atol=1e-6)


def test_the_histogram_fit_is_that_of_scipy_and_its_amplitude_samples_times_width():
    import scipy.stats

    errors = RNG.normal(0.114, 0.145, 500)
    fit = fit_histogram(errors)

    def curve(a, amplitude, mean, std):
        return amplitude * scipy.stats.norm.pdf(a, mean, std)

    begin = (500 * fit.width, errors.mean(), errors.std())
    found, cov = curve_fit(curve, fit.centres, fit.counts, begin, xtol=1e-14)
    np.testing.assert_allclose([fit.amplitude, fit.mean, fit.std], found, rtol=1e-6)
    np.testing.assert_allclose(fit.std_errors, np.sqrt(np.diag(cov)), rtol=1e-4)
    assert fit.amplitude == pytest.approx(500 * fit.width, rel=0.1)
    assert fit.counts.sum() == 500


def test_moments_scatter_less_than_the_histogram_fit():
    """Standard errors with 500 samples, from an independent program: .0082, .0071 and .0067,
    .0047."""
    rng = np.random.default_rng(8)
    fits = []
    for _ in range(400):
        errors = rng.normal(0.114, 0.145, 500)
        fit = fit_histogram(errors)
        fits.append([fit.mean, fit.std, errors.mean(), errors.std()])
    np.testing.assert_allclose(np.mean(fits, axis=0), [0.114, 0.145] * 2, atol=2e-3)
    scatter = np.std(fits, axis=0)
    np.testing.assert_allclose(scatter, [0.0082, 0.0071, 0.0067, 0.0047], rtol=0.12)
    plain = fit_curve(errors)
    assert (plain.mean, plain.std) == (errors.mean(), errors.std())
    assert plain.std_errors["mean"] == pytest.approx(0.145 / 500**0.5, rel=0.1)


def test_bad_errors_are_refused():
    with pytest.raises(DataError, match=r"found 3 errors, expected 8 or more"):
        fit_curve([0.1, 0.2, 0.3])
    with pytest.raises(DataError, match=r"error 4 is nan"):
        fit_curve([0.1, 0.2, 0.3, 0.1, np.nan, 0.2, 0.3, 0.4])
    with pytest.raises(DataError, match=r"all errors are 0\.1 m"):
        fit_curve([0.1] * 9)
    with pytest.raises(DataError, match=r"'gamma': the least error is -0\.1 m"):
        fit_curve([-0.1, 0.2, 0.3, 0.1, 0.2, 0.2, 0.3, 0.4], "gamma")
    with pytest.raises(DataError, match="no family of error curves called 'gama'"):
        fit_curve([0.1, 0.2, 0.3, 0.1, 0.2, 0.2, 0.3, 0.4], "gama")
    with pytest.raises(DataError, match="expected 8 and 4 or more"):
        fit_histogram([0.1] * 9, bins=2)
