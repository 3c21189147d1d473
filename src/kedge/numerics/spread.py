"""Process noise that widens an ensemble without being drawn for each member."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Ensemble, members_wise
from kedge.core.manifolds import space
from kedge.numerics.gram import gram
from kedge.numerics.noise import draws


def with_noise(
    step: Callable[[Any, Float[Array, " w"]], Any],
    belief: Ensemble,
    std: Float[Array, " w"],
    key: PRNGKeyArray,
) -> Ensemble:
    r"""Step the members without noise, then let their covariance grow by $G Q G^\top$.

    $A^+ = A (I + (N - 1) W^\top W)^{1/2}$ with $A W^\top = G Q^{1/2}$ in least squares, where G
    is the derivative of the step by the noise at the mean; the mean stays. What noise the
    anomalies do not span (fewer members than dimensions, or a component known exactly) cannot
    be had by stretching them: that part is drawn, about zero. With more members than
    dimensions the covariance is $P + G Q G^\top$ to rounding.

    Source: P. Raanes, A. Carrassi, L. Bertino, "Extending the square root method to account
    for additive forecast noise in ensemble methods", Mon. Weather Rev. 143, 2015 (Sqrt-Core,
    and Sqrt-Add-Z for the rest).
    """
    before, _ = belief.centred()
    calm = jnp.zeros_like(std)
    predicted = Ensemble(members_wise(step, shared=1)(belief.columns, calm))
    mean, anomalies = predicted.centred()
    states = space(mean)
    centre = step(before, calm)
    slope = jax.jacfwd(lambda noise: states.boxminus(step(before, noise), centre))(calm)

    # In units of each component's own spread, so that metres and radians weigh the same.
    count = anomalies.shape[1]
    scale = jnp.sqrt(jnp.mean(anomalies**2, axis=1))
    scale = jnp.where(scale > 0, scale, 1.0)
    A, noise = anomalies / scale[:, None], slope * std[None] / scale[:, None]
    W = _least_squares(A, noise)
    missing = noise - A @ W.T

    white = draws(key, count, jnp.ones_like(std))
    drawn = (white - jnp.mean(white, axis=1)[:, None]) * (count / (count - 1)) ** 0.5
    grown = gram(W * (count - 1) ** 0.5).applied(
        lambda values: jnp.sqrt(1 + values), lambda values: 1 / (1 + jnp.sqrt(1 + values)), A
    )
    grown = grown + missing @ drawn
    return Ensemble.around(mean, grown * scale[:, None])


def _least_squares(A: Float[Array, "n N"], right: Float[Array, "n w"]) -> Float[Array, "w N"]:
    r"""The shortest W with $A W^\top$ nearest to ``right``."""
    decomposed = gram(A)
    regular = decomposed.rank() > 0
    return decomposed.pulled(
        lambda values: jnp.where(regular, 1 / jnp.where(regular, values, 1.0), 0.0), right.T
    )
