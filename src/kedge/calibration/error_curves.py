"""How ranges err behind an obstacle: distributions fitted to errors, and the choice of one."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.core.registry import unknown

Errors = Float[np.ndarray, " n"]
LEAST = 8
"""Errors that a fit needs."""


class Curve(NamedTuple):
    """A distribution of range errors in m, as it was fitted."""

    family: str
    parameters: dict[str, float]
    std_errors: dict[str, float]
    """Of the parameters; NaN where they are not known."""
    mean: float
    std: float
    log_likelihood: float
    aic: float
    r"""$2 k - 2 \log L$ with k parameters: the least is best."""
    samples: int

    def density(self, errors: Errors) -> Errors:
        """Of an error, per m."""
        return np.exp(FAMILIES[self.family].log_density(np.asarray(errors), **self.parameters))


class Family(NamedTuple):
    """One kind of distribution."""

    start: Callable[[Errors], dict[str, float]]
    """The most likely parameters, or where the search for them begins."""
    log_density: Callable[..., Errors]
    moments: Callable[..., tuple[float, float]]
    """Mean and standard deviation."""
    closed: bool
    """Whether ``start`` is the most likely already."""
    positive: tuple[str, ...]
    """Parameters that are above 0, and are searched by their logarithm."""


def fit_curve(errors: Any, family: str = "normal") -> Curve:
    """The most likely distribution of a family.

    Standard errors are the roots of the inverse of the observed information.

    Raises:
        DataError: fewer than :data:`LEAST` errors, one is not finite, all are equal, or the
            family cannot have them.

    Source: L. Wasserman, "All of Statistics", 2004, sections 9.3 and 9.7.
    """
    values = _checked(errors)
    if family not in FAMILIES:
        raise DataError(unknown("family of error curves", family, list(FAMILIES)))
    kind = FAMILIES[family]
    parameters = kind.start(values)
    if not np.isfinite(kind.log_density(values, **parameters)).all():
        raise DataError(
            f"error curve {family!r}: the least error is {values.min():.4g} m, which it cannot "
            "have; expected errors above 0"
        )
    if not kind.closed:
        parameters = _searched(kind, values, parameters)
    likelihood = float(kind.log_density(values, **parameters).sum())
    mean, std = kind.moments(**parameters)
    return Curve(
        family, parameters, _std_errors(kind, values, parameters), float(mean), float(std),
        likelihood, 2 * len(parameters) - 2 * likelihood, len(values),
    )  # fmt: skip


def choose_curve(errors: Any) -> list[Curve]:
    """Every family that can have these errors, the best by AIC first.

    Raises:
        DataError: as for :func:`fit_curve`.

    Source: H. Akaike, "A new look at the statistical model identification", IEEE Transactions
    on Automatic Control 19(6), 1974.
    """
    values, curves = _checked(errors), []
    for family in FAMILIES:
        try:
            curves.append(fit_curve(values, family))
        except DataError:
            continue
    return sorted(curves, key=lambda curve: curve.aic)


def _checked(errors: Any) -> Errors:
    values = np.asarray(errors, float)
    if values.ndim != 1 or len(values) < LEAST:
        raise DataError(f"error curve: found {values.size} errors, expected {LEAST} or more")
    if not np.isfinite(values).all():
        at = int(np.argmin(np.isfinite(values)))
        raise DataError(f"error curve: error {at} is {values[at]}, expected finite ones")
    if np.ptp(values) == 0:
        raise DataError(f"error curve: all errors are {values[0]:g} m, expected some spread")
    return values


def _packed(kind: Family, parameters: dict[str, float]) -> np.ndarray:
    return np.array([np.log(v) if k in kind.positive else v for k, v in parameters.items()])


def _unpacked(kind: Family, names: list[str], point: np.ndarray) -> dict[str, float]:
    pairs = zip(names, point.tolist(), strict=True)
    return {k: float(np.exp(v)) if k in kind.positive else v for k, v in pairs}


def _searched(kind: Family, values: Errors, start: dict[str, float]) -> dict[str, float]:
    from scipy.optimize import minimize

    names = list(start)

    def loss(point: np.ndarray) -> float:
        with np.errstate(all="ignore"):
            total = -kind.log_density(values, **_unpacked(kind, names, point)).sum()
        return float(total) if np.isfinite(total) else 1e300

    settings = {"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000, "maxfev": 8000}
    minimum = minimize(loss, _packed(kind, start), method="Nelder-Mead", options=settings)
    return _unpacked(kind, names, minimum.x)


def _std_errors(kind: Family, values: Errors, parameters: dict[str, float]) -> dict[str, float]:
    """From second differences of the log likelihood."""
    if kind is FAMILIES["exponential"]:  # its likelihood has an edge at the shift
        scale, count = parameters["scale"], len(values)
        return {"shift": scale / count, "scale": scale / count**0.5}
    names, point = list(parameters), np.array(list(parameters.values()))
    steps = 1e-4 * np.maximum(np.abs(point), values.std())

    def total(shift: np.ndarray) -> float:
        shifted = dict(zip(names, (point + shift).tolist(), strict=True))
        return float(kind.log_density(values, **shifted).sum())

    size = len(names)
    hessian = np.empty((size, size))
    basis = np.diag(steps)
    with np.errstate(all="ignore"):
        for i in range(size):
            for j in range(size):
                corners = [
                    a * b * total(a * basis[i] + b * basis[j]) for a in (1, -1) for b in (1, -1)
                ]
                hessian[i, j] = sum(corners) / (4 * steps[i] * steps[j])
        try:
            variance = np.diag(np.linalg.inv(-hessian))
        except np.linalg.LinAlgError:
            variance = np.full(size, np.nan)
        roots = np.sqrt(np.where(variance > 0, variance, np.nan))
    return dict(zip(names, roots.tolist(), strict=True))


def _normal(x: Errors, mean: float, std: float) -> Errors:
    return -0.5 * ((x - mean) / std) ** 2 - np.log(std) - 0.5 * np.log(2 * np.pi)


def _exponential(x: Errors, shift: float, scale: float) -> Errors:
    inside = x >= shift - 1e-12
    return np.where(inside, -(x - shift) / scale - np.log(scale), -np.inf)


def _gamma(x: Errors, shape: float, scale: float) -> Errors:
    from scipy.special import gammaln

    safe = np.where(x > 0, x, 1.0)
    value = (shape - 1) * np.log(safe) - safe / scale - gammaln(shape) - shape * np.log(scale)
    return np.where(x > 0, value, -np.inf)


def _emg(x: Errors, mean: float, std: float, tail: float) -> Errors:
    from scipy.special import log_ndtr

    ahead = (x - mean) / std
    ratio = std / tail
    return -np.log(tail) + ratio**2 / 2 - ahead * ratio + log_ndtr(ahead - ratio)


def _mixture(
    x: Errors, mean: float, std: float, blocked_mean: float, blocked_std: float, share: float
) -> Errors:
    if not 0 < share < 1:
        return np.full_like(x, np.nan)
    clear = np.log1p(-share) + _normal(x, mean, std)
    return np.logaddexp(clear, np.log(share) + _normal(x, blocked_mean, blocked_std))


def _mixture_start(x: Errors) -> dict[str, float]:
    """By expectation maximisation, from the halves below and above the median."""
    middle, spread = np.median(x), max(x.std(), 1e-9)
    low, high = x[x <= middle].mean(), x[x > middle].mean()
    narrow, wide, share = spread / 2, spread, 0.5
    floor = 1e-3 * spread  # a component that shrinks to one error would be infinitely likely
    for _ in range(200):
        logs = (
            np.log(share) + _normal(x, high, wide) - _mixture(x, low, narrow, high, wide, share)
        )
        gamma = np.exp(logs)
        share = float(np.clip(gamma.mean(), 1e-6, 1 - 1e-6))
        low, high = ((1 - gamma) @ x / (1 - gamma).sum(), gamma @ x / gamma.sum())
        narrow = max(np.sqrt((1 - gamma) @ (x - low) ** 2 / (1 - gamma).sum()), floor)
        wide = max(np.sqrt(gamma @ (x - high) ** 2 / gamma.sum()), floor)
    return {
        "mean": float(low), "std": float(narrow), "blocked_mean": float(high),
        "blocked_std": float(wide), "share": share,
    }  # fmt: skip


def _mixture_moments(
    mean: float, std: float, blocked_mean: float, blocked_std: float, share: float
) -> tuple[float, float]:
    whole = (1 - share) * mean + share * blocked_mean
    second = (1 - share) * (std**2 + mean**2) + share * (blocked_std**2 + blocked_mean**2)
    return whole, float(np.sqrt(second - whole**2))


def _emg_start(x: Errors) -> dict[str, float]:
    skew = np.mean((x - x.mean()) ** 3) / x.std() ** 3
    tail = float(x.std() * np.clip(skew / 2, 1e-3, 0.99) ** (1 / 3))
    std = float(np.sqrt(max(x.var() - tail**2, 1e-4 * x.var())))
    return {"mean": float(x.mean()) - tail, "std": std, "tail": tail}


FAMILIES: dict[str, Family] = {
    "normal": Family(
        lambda x: {"mean": float(x.mean()), "std": float(x.std())},
        _normal,
        lambda mean, std: (mean, std),
        True,
        ("std",),
    ),
    "exponential": Family(
        lambda x: {"shift": float(x.min()), "scale": float(x.mean() - x.min())},
        _exponential,
        lambda shift, scale: (shift + scale, scale),
        True,
        ("scale",),
    ),
    "gamma": Family(
        lambda x: (
            {"shape": float(x.mean() ** 2 / x.var()), "scale": float(x.var() / x.mean())}
            if x.min() > 0
            else {"shape": 1.0, "scale": 1.0}
        ),
        _gamma,
        lambda shape, scale: (shape * scale, shape**0.5 * scale),
        False,
        ("shape", "scale"),
    ),
    "emg": Family(
        _emg_start,
        _emg,
        lambda mean, std, tail: (mean + tail, (std**2 + tail**2) ** 0.5),
        False,
        ("std", "tail"),
    ),
    "mixture": Family(_mixture_start, _mixture, _mixture_moments, True, ("std", "blocked_std")),
}
"""Normal; exponential from a shift on; gamma; normal with an exponential tail (EMG); two normal
distributions, one in line of sight and one not."""
