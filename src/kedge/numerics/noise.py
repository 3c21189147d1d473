"""Noise standard deviations and samples implied by the contracts."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.contracts import AbstractVehicle
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.numerics.linalg import UNROLLED_COLUMNS, square_root
from kedge.numerics.random import normals


def process_std(vehicle: AbstractVehicle, dt: Scalar) -> Float[Array, " w"]:
    r"""Standard deviation $\sqrt{Q / \Delta t}$ of the noise held over a step of ``dt``."""
    density = vehicle.noise_density()
    return space(density).flatten(density) / jnp.sqrt(dt)


def draws(key: PRNGKeyArray, count: int, std: Float[Array, " w"]) -> Float[Array, "w N"]:
    """``count`` normal vectors of these standard deviations, side by side.

    A model without noise costs no random numbers, which for large ensembles take longer than
    the model does.
    """

    def sample() -> Float[Array, "w N"]:
        return normals(key, (*std.shape, count), std.dtype) * std[:, None]

    silent = jnp.zeros((*std.shape, count), std.dtype)
    return lax.cond(jnp.any(std != 0), sample, lambda: silent)


def correlated(white: Float[Array, "n N"], cov: Float[Array, "n n"]) -> Float[Array, "n N"]:
    """White columns given a covariance; a diagonal one, as many priors, is not factorised."""
    if cov.shape[0] <= UNROLLED_COLUMNS:
        return square_root(cov) @ white
    variance = jnp.diag(cov)
    return lax.cond(
        jnp.all((cov == jnp.diag(variance)) & (variance >= 0)[None]),
        lambda: white * jnp.sqrt(variance)[:, None],
        lambda: square_root(cov) @ white,
    )


def coloured(
    white: Float[Array, " m"],
    variance: Float[Array, " m"] | None,
    cov: Callable[[], Float[Array, "m m"]],
) -> Float[Array, " m"]:
    """White noise given the variances of independent components, or else a covariance."""
    return square_root(cov()) @ white if variance is None else jnp.sqrt(variance) * white
