"""Lorenz-96: a ring of coupled quantities, chaotic, of any size."""

import functools as ft
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.errors import ContractError
from kedge.core.quantities import Ratio
from kedge.core.registry import vehicles
from kedge.vehicles.benchmarks.autonomous import AbstractAutonomous, values_of

ring = ft.cache(values_of)
"""The state class of a ring of some size: one for each size."""


@vehicles.add("lorenz96")
class Lorenz96(AbstractAutonomous):
    r"""``size`` quantities on a ring, with advection, damping and constant forcing.

    $\dot x_i = (x_{i+1} - x_{i-2})\, x_{i-1} - x_i + F + w_i$, indices modulo the size.

    Chaotic for $F = 8$; 0.05 units of time are about 6 hours of weather, and one Runge-Kutta
    step of that length is what the literature uses. The state starts at rest except for a
    nudge, off the attractor: some units of time carry it there.

    Source: E. Lorenz, "Predictability: a problem partly solved", ECMWF Seminar on
    Predictability, 1996; E. Lorenz, K. Emanuel, "Optimal sites for supplementary weather
    observations", J. Atmos. Sci. 55, 1998, section 2.
    """

    size: int = eqx.field(static=True, default=40)
    forcing: Ratio = 8.0

    def __check_init__(self):
        if self.size < 4:
            raise ContractError(f"lorenz96: size is {self.size}, must be at least 4")

    def flow(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        advection = (jnp.roll(x, -1) - jnp.roll(x, 2)) * jnp.roll(x, 1)
        return advection - x + self.forcing

    def start(self) -> Any:
        return ring(self.size)(jnp.zeros(self.size).at[0].set(1.0))
