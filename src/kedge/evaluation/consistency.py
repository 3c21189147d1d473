"""Does an estimator know how good it is: chi-square bounds, coverage, whiteness, intervals.

Quantiles come from ``scipy.special``, since ``scipy.stats`` takes seconds to import.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int
from scipy.special import chdtrc, gammainccinv, gammaincinv, ndtri, stdtrit

from kedge.core.errors import ConfigError, DataError

Errors = Float[Array | np.ndarray, "*batch n"]
Covariances = Float[Array | np.ndarray, "*batch n n"]


class Consistency(NamedTuple):
    """An average NEES or NIS of ``size`` values, and the interval it should lie in."""

    average: float
    lower: float
    upper: float
    size: int

    @property
    def verdict(self) -> str:
        """Too large an average says that the covariance is too small: "optimistic"."""
        if not np.isfinite(self.average):
            return "not finite"
        if self.average > self.upper:
            return "optimistic"
        return "pessimistic" if self.average < self.lower else "consistent"


class Whiteness(NamedTuple):
    """Autocorrelation by ``lag``, the band white noise keeps at each lag, and one test of all.

    Where no pair of values is so many rows apart, autocorrelation and band are NaN.
    """

    lag: Int[np.ndarray, " L"]
    autocorrelation: Float[np.ndarray, " L"]
    band: Float[np.ndarray, " L"]
    statistic: float
    dof: int
    p_value: float
    white: bool


class MeanInterval(NamedTuple):
    """A mean, its confidence interval, and how many independent values it is worth."""

    mean: float
    lower: float
    upper: float
    std_error: float
    effective_size: float


def nees(error: Errors, cov: Covariances) -> Float[Array, "*batch"]:
    r"""Compute the normalised estimation error squared, $e^T P^{-1} e$.

    NaN where the covariance is not positive definite, so that it cannot pass for a small error.

    Source: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to
    Tracking and Navigation", 2001, section 5.4.2.
    """
    root = jnp.linalg.cholesky(jnp.asarray(cov))
    white = solve_triangular(root, jnp.asarray(error)[..., None], lower=True)
    return jnp.sum(white[..., 0] ** 2, axis=-1)


def singular(cov: Covariances) -> float:
    """The share of covariances that are not positive definite, so that there is no NEES."""
    return float(jnp.mean(jnp.isnan(nees(jnp.zeros(jnp.shape(cov)[:-1]), cov))))


def nis(
    residual: Float[Array | np.ndarray, "*batch m"],
    cov: Float[Array | np.ndarray, "*batch m m"],
) -> Float[Array, "*batch"]:
    r"""Compute the normalised innovation squared, $\nu^T S^{-1} \nu$, of what was measured.

    Components that are NaN were not measured and are left out, with their rows and columns of
    the covariance: the law is then chi-square with the number of finite components. NaN where
    there is none.

    Source: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to
    Tracking and Navigation", 2001, section 5.4.2.
    """
    residual, cov = jnp.asarray(residual), jnp.asarray(cov)
    present = ~jnp.isnan(residual)
    both = present[..., :, None] & present[..., None, :]
    unit = jnp.broadcast_to(jnp.eye(residual.shape[-1], dtype=cov.dtype), cov.shape)
    squared = nees(jnp.where(present, residual, 0.0), jnp.where(both, cov, unit))
    return jnp.where(jnp.any(present, axis=-1), squared, jnp.nan)


def chi_square_bound(dof: float | int, probability: float) -> float:
    """Find the value that a chi-square variable stays below with ``probability``.

    Raises:
        ConfigError: the probability is not between 0 and 1.
    """
    _require_probability(probability)
    return 2 * float(gammaincinv(dof / 2, probability))


def chi_square_interval(
    dof: float | int, runs: int = 1, probability: float = 0.95
) -> tuple[float, float]:
    r"""Find the two-sided bounds of the average of ``runs`` independent chi-square values.

    $\sum_i \epsilon_i \sim \chi^2_{\text{runs} \cdot \text{dof}}$, so the bounds are quantiles
    of that law divided by the number of runs, with equal shares left out below and above.

    Raises:
        ConfigError: the probability is not between 0 and 1.

    Source: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to
    Tracking and Navigation", 2001, section 5.4.2.
    """
    _require_probability(probability)
    shape, tail = runs * dof / 2, (1 - probability) / 2
    return 2 * float(gammaincinv(shape, tail)) / runs, 2 * float(
        gammainccinv(shape, tail)
    ) / runs


def consistency(
    values: Float[np.ndarray, "..."],
    dof: int | Int[np.ndarray, "..."],
    probability: float = 0.95,
) -> Consistency:
    """Judge the average of independent NEES or NIS values by :func:`chi_square_interval`.

    Independent are the NEES at one time over runs, and the NIS of one run over time (under the
    hypothesis tested); the NEES of one run over time are not: see :func:`mean_interval`.
    ``dof`` may differ by value. Values without degrees of freedom (nothing measured) are left
    out; a NaN among the others is an estimate that failed, and so is the verdict.

    Raises:
        DataError: no value has a degree of freedom.
        ConfigError: the probability is not between 0 and 1.
    """
    dofs = np.broadcast_to(dof, np.shape(values))
    count = int(np.count_nonzero(dofs))
    if not count:
        raise DataError("no value to average")
    lower, upper = chi_square_interval(float(dofs.sum()) / count, count, probability)
    return Consistency(float(np.mean(np.asarray(values)[dofs > 0])), lower, upper, count)


def coverage(error: Errors, cov: Covariances, probability: float = 0.95) -> Float[Array, ""]:
    """Compute the share of errors in the ellipsoid that should hold ``probability`` of them.

    NaN errors and covariances that are not positive definite count as outside: an estimate
    that failed is not one that knew.

    Raises:
        ConfigError: the probability is not between 0 and 1.
    """
    return jnp.mean(nees(error, cov) <= chi_square_bound(error.shape[-1], probability))


def whiteness(
    residuals: Float[np.ndarray, "T m"], lags: int, probability: float = 0.95
) -> Whiteness:
    r"""Test standardised innovations for correlation over time.

    $\rho_k = \sum_i \sum_t z_{it} z_{i,t+k} / \sum_i N_{ik}$ with $z_i$ the component divided
    by its root mean square, over the $N_{ik}$ pairs of rows where neither is NaN;
    $Q = \sum_i n_i (n_i + 2) \sum_k r_{ik}^2 / N_{ik}$ is chi-square with one degree of
    freedom for each component and lag. The $r_{ik}$ are the components' own autocorrelations,
    so opposite ones cancel in $\rho_k$ but not in $Q$. No mean is subtracted: innovations have
    none, and a bias should show, as a correlation at every lag.

    Lags count rows. Pass the rows of one sensor; columns may also be runs.

    Raises:
        DataError: a component is always NaN or zero, or no two values are so close.
        ConfigError: ``lags`` or the probability is out of range.

    Source: G. M. Ljung and G. E. P. Box, "On a measure of lack of fit in time series models",
    Biometrika 65(2), 1978, section 1; missing values as in D. S. Stoffer and C. M. C. Toloi,
    "A note on the Ljung-Box-Pierce portmanteau statistic with missing data", Statistics and
    Probability Letters 13(5), 1992.
    """
    _require_probability(probability)
    if not 1 <= lags < len(residuals):
        raise ConfigError(f"lags: found {lags}, expected 1 to {len(residuals) - 1}")
    present = ~np.isnan(residuals)
    values, sizes = np.where(present, residuals, 0.0), present.sum(axis=0)
    power = np.sum(values**2, axis=0)
    if not np.all(power > 0):
        raise DataError(f"component {int(np.argmin(power))} is always NaN or always zero")
    correlation = np.stack(
        [np.sum(values[:-k] * values[k:], axis=0) for k in range(1, lags + 1)]
    )
    pairs = np.stack([np.sum(present[:-k] & present[k:], axis=0) for k in range(1, lags + 1)])
    if not np.any(pairs):
        raise DataError(f"no two values are {lags} rows or fewer apart: pass one sensor's rows")
    correlation = correlation / power[None]
    # The variance of r_ik is N_ik / (n_i (n_i + 2)), exactly so for white normal values.
    weight = (sizes * (sizes + 2.0))[None]
    statistic = float(np.sum(weight * correlation**2 / np.maximum(pairs, 1)))
    dof = int(np.count_nonzero(pairs))
    p_value = float(chdtrc(dof, statistic))
    total = np.where(np.any(pairs, axis=1), pairs.sum(axis=1), np.nan)
    pooled = np.sum(correlation * sizes[None], axis=1) / total
    spread = np.sqrt(np.sum(sizes[None] ** 2 * pairs / weight, axis=1)) / total
    band = float(ndtri((1 + probability) / 2)) * spread
    lag, white = np.arange(1, lags + 1), p_value >= 1 - probability
    return Whiteness(lag, pooled, band, statistic, dof, p_value, white)


def mean_interval(values: Float[np.ndarray, " T"], probability: float = 0.95) -> MeanInterval:
    r"""Find a confidence interval of the mean of correlated values.

    $\bar x \pm t \, s / \sqrt{n_e},\quad n_e = n / (1 + 2 \sum_k \rho_k)$

    The sum runs over pairs of neighbouring lags while they stay positive and falling; t is
    Student's quantile with $n_e - 1$ degrees of freedom. NaN values are missing but keep their
    place in time. Negative correlation is not trusted to make $n_e$ larger than n.

    Raises:
        DataError: fewer than two values.
        ConfigError: the probability is not between 0 and 1.

    Source: C. J. Geyer, "Practical Markov chain Monte Carlo", Statistical Science 7(4), 1992,
    section 3.3 (initial monotone sequence).
    """
    _require_probability(probability)
    known = ~np.isnan(values)
    if (count := int(known.sum())) < 2:
        raise DataError(f"a mean interval needs two values or more, found {count}")
    mean = float(np.mean(values[known]))
    deviation = np.where(known, values - mean, 0.0)
    # Zeros up to twice the length keep the circular correlation from wrapping round.
    spectrum = np.abs(np.fft.rfft(deviation, 2 * len(values))) ** 2
    covariance = np.fft.irfft(spectrum)[: len(values)]
    couples = np.append(covariance, np.zeros(len(values) % 2)).reshape(-1, 2).sum(axis=1)
    positive = np.minimum.accumulate(couples).clip(min=0.0)
    inflation = (2 * positive.sum() - covariance[0]) / covariance[0] if covariance[0] > 0 else 1
    effective = count / max(float(inflation), 1.0)
    std_error = float(np.sqrt(np.sum(deviation**2) / (count - 1) / effective))
    half = float(stdtrit(max(effective - 1, 1.0), (1 + probability) / 2)) * std_error
    return MeanInterval(mean, mean - half, mean + half, std_error, effective)


def _require_probability(probability: float) -> None:
    if not 0 < probability < 1:
        raise ConfigError(f"probability: found {probability}, expected one between 0 and 1")
