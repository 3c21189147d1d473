"""Allan deviation: which noise a sensor has that stands still, and how much of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from kedge.core.errors import DataError

LEAST = 64
"""Samples that a record needs."""
FLICKER = 2 * np.log(2) / np.pi


class AllanCurve(NamedTuple):
    """Overlapping Allan deviations of one signal."""

    tau: Float[np.ndarray, " n"]  # s
    deviation: Float[np.ndarray, " n"]
    """In the unit of the signal."""
    freedom: Float[np.ndarray, " n"]
    """About how many independent differences each rests on."""


class AllanFit(NamedTuple):
    """The coefficients of an IMU's noise model; zero where the record shows none."""

    noise: float
    """N: white noise, in the unit per root hertz."""
    instability: float
    """B: flicker, in the unit."""
    walk: float
    """K: random walk, in the unit per second per root hertz."""

    def variance(self, tau: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        r"""$\sigma^2(\tau) = N^2 / \tau + \tfrac{2 \ln 2}{\pi} B^2 + \tfrac13 K^2 \tau$."""
        return np.array(_shapes(tau)).T @ np.square(self)


def allan(values: Float[np.ndarray, " n"], period: float, points: int = 40) -> AllanCurve:
    r"""Overlapping Allan deviation of samples that are means over their period.

    $\sigma^2(m T) = \frac{1}{2 (m T)^2 (n + 1 - 2m)} \sum_k (\theta_{k+2m} - 2 \theta_{k+m} +
    \theta_k)^2$ with the integral $\theta$ of the signal, for up to ``points`` spans m that are
    spread evenly in their logarithm, up to an eighth of the record.

    Source: IEEE Std 952, "IEEE standard specification format guide and test procedure for
    single-axis interferometric fiber optic gyros", 1997, annex C.

    Raises:
        DataError: there are too few samples.
    """
    if len(values) < LEAST:
        raise DataError(f"found {len(values)} samples, expected at least {LEAST}")
    # A mean that is taken off keeps the digits of a long integral.
    integral = np.append(0.0, np.cumsum(values - values.mean())) * period
    longest = max(len(values) // 8, 1)
    spans: Int[np.ndarray, " m"] = np.unique(
        np.round(np.geomspace(1, longest, points)).astype(int)
    )
    deviation = []
    for m in spans:
        second = integral[2 * m :] - 2 * integral[m:-m] + integral[: -2 * m]
        deviation.append(np.sqrt(np.mean(second**2) / 2) / (m * period))
    freedom = np.maximum(len(values) / spans - 1, 1.0)
    return AllanCurve(spans * period, np.array(deviation), freedom)


def fit(curves: list[AllanCurve]) -> AllanFit:
    """The coefficients that explain the curves of like axes, by their relative variances.

    Non-negative least squares, each deviation weighted by what it rests on and by the model
    itself, which takes a few rounds.

    Source: IEEE Std 952, "IEEE standard specification format guide and test procedure for
    single-axis interferometric fiber optic gyros", 1997, annex C (the model).
    """
    from scipy.optimize import nnls

    tau = np.concatenate([curve.tau for curve in curves])
    squared = np.concatenate([curve.deviation**2 for curve in curves])
    freedom = np.concatenate([curve.freedom for curve in curves])
    if not squared.any():
        return AllanFit(0.0, 0.0, 0.0)
    shapes, model = np.array(_shapes(tau)).T, np.maximum(squared, squared[squared > 0].min())
    coefficients = np.zeros(3)
    for _ in range(20):
        weight = np.sqrt(freedom) / model
        scale = np.linalg.norm(shapes * weight[:, None], axis=0)
        coefficients = nnls(shapes * weight[:, None] / scale[None], squared * weight)[0] / scale
        model = shapes @ coefficients
    return AllanFit(*(float(np.sqrt(value)) for value in coefficients))


def _shapes(tau: Float[np.ndarray, " n"]) -> list[Float[np.ndarray, " n"]]:
    return [1 / tau, np.full_like(tau, FLICKER), tau / 3]
