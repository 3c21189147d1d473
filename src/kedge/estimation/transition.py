"""What smoothing needs of a prediction: where it led, and how the past hangs on it."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from kedge.core.beliefs import Ensemble, Gaussian
from kedge.core.contracts import AbstractFilter, AbstractGaussianFilter, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.filters.wrappers.wrapper import AbstractWrapper
from kedge.numerics.gram import gram
from kedge.numerics.linalg import cholesky, gain


class History(NamedTuple):
    """The record of a Gaussian's prediction."""

    predicted: Gaussian
    cross: Float[Array, "*T n n"]
    """Covariance of the state after the event before with the state predicted here."""

    def smoothing_gain(self) -> Float[Array, "n n"]:
        r"""$G = C\,(P^-)^{-1}$."""
        cov = self.predicted.cov
        # Jitter relative to each variance: a state known exactly has a singular one.
        return gain(self.cross, cholesky(cov + jnp.diag(1e-12 * jnp.diag(cov) + 1e-300)))


class EnsembleHistory(NamedTuple):
    """The record of an ensemble's prediction, whose covariance may have no inverse."""

    predicted: Gaussian
    gain: Float[Array, "*T n n"]

    def smoothing_gain(self) -> Float[Array, "n n"]:
        r"""$G = A (A^-)^+$ of the anomalies before and after the prediction."""
        return self.gain


def is_smoothable(filter: AbstractFilter) -> bool:
    """Whether a filter's predictions can be smoothed: its own, or those of what it wraps."""
    inner = innermost(filter)
    return isinstance(inner, AbstractGaussianFilter | AbstractEnsembleFilter)


def require_smoothable(filter: AbstractFilter) -> None:
    """Refuse to smooth what carries neither a Gaussian nor an ensemble.

    Raises:
        ContractError: it does not.
    """
    if not is_smoothable(filter):
        raise ContractError(
            f"{type(innermost(filter)).__name__} cannot be smoothed: it carries neither a "
            "Gaussian nor an ensemble; use for example 'extended', 'unscented' or 'ensemble'"
        )


def predict_with_record(
    filter: AbstractFilter,
    vehicle: AbstractVehicle,
    belief: Any,
    control: Any,
    dt: Scalar,
    key: PRNGKeyArray,
    moves: Bool[Array, ""] | None = None,
) -> tuple[Any, History | EnsembleHistory]:
    """The filter's prediction, and what a smoother needs of it; free where ``dt`` is zero.

    ``moves`` says whether it is not, where all runs of a batch know that and not ``dt``.
    """
    return lax.cond(
        dt > 0 if moves is None else moves,
        lambda: _moving(filter, vehicle, belief, control, dt, key),
        lambda: (belief, still(filter, belief)),
    )


def _moving(
    filter: AbstractFilter,
    vehicle: AbstractVehicle,
    belief: Any,
    control: Any,
    dt: Scalar,
    key: PRNGKeyArray,
) -> tuple[Any, History | EnsembleHistory]:
    if isinstance(filter, AbstractGaussianFilter):
        predicted, cross = filter.transition(vehicle, belief, control, dt)
        return predicted, History(predicted.moments(), cross)
    after = filter.predict(vehicle, belief, control, dt, key)
    if isinstance(filter, AbstractWrapper):
        # The compiler finds that the inner prediction is done already.
        inside = filter.unwrap(belief)
        return after, _moving(filter.inner, vehicle, inside, control, dt, key)[1]
    return after, _ensemble_history(belief, after)


def still(filter: AbstractFilter, belief: Any) -> History | EnsembleHistory:
    """What a smoother needs of a prediction over no time."""
    if isinstance(filter, AbstractWrapper):
        return still(filter.inner, filter.unwrap(belief))
    if isinstance(filter, AbstractGaussianFilter):
        at = belief.moments()
        return History(at, at.cov)
    return _ensemble_history(belief, belief)


def _ensemble_history(before: Ensemble, after: Ensemble) -> EnsembleHistory:
    r"""$A (A^-)^+ = A\,((A^-)^\top A^-)^+ (A^-)^\top$, in the smaller space.

    Source: P. Raanes, "On the ensemble Rauch-Tung-Striebel smoother and its equivalence to the
    ensemble Kalman smoother", Q. J. R. Meteorol. Soc. 142, 2016.
    """
    _, past = before.centred()
    mean, anomalies = after.centred()
    cov = anomalies @ anomalies.T / (anomalies.shape[1] - 1)
    return EnsembleHistory(Gaussian(mean, cov), past @ _pseudo_inverse(anomalies))


def _pseudo_inverse(anomalies: Float[Array, "n N"]) -> Float[Array, "N n"]:
    parts = gram(anomalies)
    kept = parts.rank() > 0
    inverse = jnp.where(kept, 1 / jnp.where(kept, parts.values, 1.0), 0.0)
    middle = (parts.vectors * inverse[None]) @ parts.vectors.T
    return middle @ anomalies.T if parts.by_column else anomalies.T @ middle


def innermost(filter: AbstractFilter) -> AbstractFilter:
    """The filter that all the wrappers are around."""
    while isinstance(filter, AbstractWrapper):
        filter = filter.inner
    return filter
