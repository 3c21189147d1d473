"""Noise standard deviations and samples implied by the contracts."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar


def process_std(vehicle: AbstractVehicle, dt: Scalar) -> Float[Array, " w"]:
    r"""Standard deviation $\sqrt{Q / \Delta t}$ of the noise held over a step of ``dt``."""
    density = vehicle.noise_density()
    return space(density).flatten(density) / jnp.sqrt(dt)
