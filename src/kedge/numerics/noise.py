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


def draws(key: PRNGKeyArray, count: int, std: Float[Array, " w"]) -> Float[Array, "N w"]:
    """``count`` normal vectors of these standard deviations.

    A model without noise costs no random numbers, which for large ensembles take longer than
    the model does.
    """

    def sample() -> Float[Array, "N w"]:
        return normals(key, (count, *std.shape), std.dtype) * std[None]

    silent = jnp.zeros((count, *std.shape), std.dtype)
    return lax.cond(jnp.any(std != 0), sample, lambda: silent)


def correlated(white: Float[Array, "N n"], cov: Float[Array, "n n"]) -> Float[Array, "N n"]:
    """White rows given a covariance; a diagonal one, as priors often are, is not factorised."""
    if cov.shape[0] <= UNROLLED_COLUMNS:
        return white @ square_root(cov).T
    variance = jnp.diag(cov)
    return lax.cond(
        jnp.all((cov == jnp.diag(variance)) & (variance >= 0)[None]),
        lambda: white * jnp.sqrt(variance)[None],
        lambda: white @ square_root(cov).T,
    )


def coloured(
    white: Float[Array, " m"],
    variance: Float[Array, " m"] | None,
    cov: Callable[[], Float[Array, "m m"]],
) -> Float[Array, " m"]:
    """White noise given the variances of independent components, or else a covariance."""
    return square_root(cov()) @ white if variance is None else jnp.sqrt(variance) * white
