"""Paper D's fit of an error curve: a normal curve through a histogram."""

from typing import Any, NamedTuple

import numpy as np

from kedge.calibration.error_curves import LEAST
from kedge.core.errors import DataError


class HistogramFit(NamedTuple):
    """A normal curve through the counts of a histogram."""

    amplitude: float
    """About the number of errors times the width of a bin, m."""
    mean: float  # m
    std: float  # m
    std_errors: tuple[float, float, float]
    """Of the amplitude, the mean and the standard deviation."""
    centres: np.ndarray
    counts: np.ndarray
    width: float  # m


def fit_histogram(errors: Any, bins: int = 20) -> HistogramFit:
    r"""Minimise $\sum_{k=1}^w (f(a_k) - b_k)^2$ over the amplitude, mean and deviation of f.

    $f(a) = \frac{A}{\sqrt{2 \pi} \sigma} \exp(-\frac{(a - \bar x)^2}{2 \sigma^2})$ at the
    middles $a_k$ of the bins, with the counts $b_k$; by BFGS with the gradient written out, in
    $(A, \bar x, \ln \sigma)$. For n errors and bins of a width b, $A \approx n b$. Moments and
    maximum likelihood (:func:`kedge.calibration.error_curves.fit_curve`) scatter less.

    Raises:
        DataError: too few errors or bins, or errors that are not finite or all the same.

    Source: J. Qiu, Y. Zhang, M. Tang, P. Ma, J. Ran, "Research on AGV positioning method
    combined with IMU and UWB", Archives of Transport 64(4), 2022, equations 8 and 9, with the
    roles of a and b as they must be.
    """
    from scipy.optimize import minimize

    values = np.asarray(errors, float)
    if values.ndim != 1 or len(values) < LEAST or bins < 4:
        raise DataError(
            f"histogram: found {values.size} errors and {bins} bins, expected {LEAST} and 4 or "
            "more"
        )
    if not np.isfinite(values).all() or np.ptp(values) == 0:
        raise DataError("histogram: found errors that are not finite, or all the same")
    counts, edges = np.histogram(values, bins)
    centres, width = (edges[1:] + edges[:-1]) / 2, float(edges[1] - edges[0])
    # In units of the start all three are about one, as a quasi-Newton method wants them.
    units = np.array([len(values) * width, values.std(), 1.0])
    begin = np.array([1.0, values.mean() / values.std(), 0.0])
    peak = len(values) * width / values.std()

    def parts(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals, and their derivatives by the scaled parameters."""
        amplitude, mean, std = point[0], point[1], np.exp(point[2])
        ahead = (centres / units[1] - mean) / std
        shape = np.exp(-(ahead**2) / 2) / (np.sqrt(2 * np.pi) * std)
        value = amplitude * shape
        slopes = np.stack([shape, value * ahead / std, value * (ahead**2 - 1)], axis=1)
        return value - counts / peak, slopes

    def loss(point: np.ndarray) -> tuple[float, np.ndarray]:
        misfit, slopes = parts(point)
        return float(misfit @ misfit), 2 * slopes.T @ misfit

    optimum = minimize(loss, begin, jac=True, method="BFGS", options={"gtol": 1e-10}).x
    misfit, slopes = parts(optimum)
    variance = misfit @ misfit / max(bins - 3, 1)
    spread = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)) * variance)
    std = float(units[1] * np.exp(optimum[2]))
    return HistogramFit(
        float(optimum[0] * units[0]),
        float(optimum[1] * units[1]),
        std,
        (float(spread[0] * units[0]), float(spread[1] * units[1]), float(spread[2] * std)),
        centres,
        counts,
        width,
    )
