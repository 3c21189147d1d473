"""The last step of a cloud as a function of its noise, so that it can be drawn again."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from kedge.core.beliefs import LastStep
from kedge.core.manifolds import space
from kedge.numerics.noise import process_std


def redrawable(
    last: LastStep,
) -> tuple[Bool[Array, ""], Callable[[Any, Float[Array, " w"]], Any], Float[Array, " w"]]:
    """Whether there is a step to draw again, the step, and the deviations of its noise."""
    pending = last.dt > 0
    # A step of no length has noise of infinite power; it is not used, but must be finite.
    dt = jnp.where(pending, last.dt, 1.0).astype(last.dt.dtype)
    noises = space(last.vehicle.noise_density())

    def step(state: Any, noise: Float[Array, " w"]) -> Any:
        return last.vehicle.step(state, last.control, noises.unflatten(noise), dt)

    return pending, step, process_std(last.vehicle, dt)
