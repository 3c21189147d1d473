"""Robust losses of a snapshot: what a residual costs, and the weight that follows."""

from typing import Literal, get_args

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.errors import ContractError
from kedge.numerics.losses import TUNING as OF_FILTERS

Loss = Literal["l2", "huber", "cauchy", "tukey", "geman-mcclure"]
LOSSES = get_args(Loss)
REDESCENDING = ("cauchy", "tukey", "geman-mcclure")
"""Those with several minima: they begin at Huber's solution."""
TUNING = {
    "l2": 1.0,
    "tukey": 4.685,
    **{name: OF_FILTERS[name] for name in ("huber", "cauchy", "geman-mcclure")},
}
"""In standard deviations: 95 % efficiency if the noise is Gaussian after all."""


def check_loss(loss: str, tuning: float) -> None:
    """Refuse a loss that there is not.

    Raises:
        ContractError: it is unknown, or its scale is not above 0.
    """
    if loss not in LOSSES:
        raise ContractError(f"loss is {loss!r}, must be one of {', '.join(LOSSES)}")
    if isinstance(tuning, int | float) and tuning < 0:
        raise ContractError(f"tuning is {tuning:g}, must be above 0, or 0 for the usual one")


def cost(loss: str, scale: Array | float, error: Float[Array, " m"]) -> Float[Array, " m"]:
    r"""The loss $\rho(e)$ of a residual in standard deviations.

    =============  ==========================================================
    l2             $e^2 / 2$
    huber          $e^2 / 2$ up to c, then $c |e| - c^2 / 2$
    cauchy         $\tfrac{c^2}{2} \log(1 + e^2 / c^2)$
    tukey          $\tfrac{c^2}{6} (1 - (1 - e^2 / c^2)^3)$ up to c, then its maximum
    geman-mcclure  $\tfrac12 e^2 / (1 + e^2 / c^2)$
    =============  ==========================================================

    Source: Z. Zhang, "Parameter estimation techniques: a tutorial with application to conic
    fitting", Image and Vision Computing 15(1), 1997, section 9.4.
    """
    squared = error**2 / scale**2
    if loss == "huber":
        size = jnp.abs(error)
        return jnp.where(size <= scale, error**2 / 2, scale * size - scale**2 / 2)
    if loss == "cauchy":
        return scale**2 / 2 * jnp.log1p(squared)
    if loss == "tukey":
        return scale**2 / 6 * (1 - jnp.maximum(1 - squared, 0.0) ** 3)
    if loss == "geman-mcclure":
        return error**2 / 2 / (1 + squared)
    return error**2 / 2


def weight(loss: str, scale: Array | float, error: Float[Array, " m"]) -> Float[Array, " m"]:
    r"""$\rho'(e) / e$: what a squared residual is weighed with."""
    squared = error**2 / scale**2
    if loss == "huber":
        return 1 / jnp.maximum(1.0, jnp.sqrt(squared))
    if loss == "cauchy":
        return 1 / (1 + squared)
    if loss == "tukey":
        return jnp.maximum(1 - squared, 0.0) ** 2
    if loss == "geman-mcclure":
        return 1 / (1 + squared) ** 2
    return jnp.ones_like(error)


def curvature(loss: str, scale: Array | float, error: Float[Array, " m"]) -> Float[Array, " m"]:
    r"""$\rho''(e)$, within a tenth of the weight and the weight.

    Steps with it converge much faster than with the weights, which overstate the curvature of
    what is far off, and are still downhill.
    """
    squared, weighed = error**2 / scale**2, weight(loss, scale, error)
    if loss == "huber":
        exact = jnp.where(squared <= 1, 1.0, 0.0)
    elif loss == "cauchy":
        exact = (1 - squared) / (1 + squared) ** 2
    elif loss == "tukey":
        exact = (1 - squared) * (1 - 5 * squared)
    elif loss == "geman-mcclure":
        exact = (1 - 3 * squared) / (1 + squared) ** 3
    else:
        exact = weighed
    return jnp.clip(exact, 0.1 * weighed, weighed)
