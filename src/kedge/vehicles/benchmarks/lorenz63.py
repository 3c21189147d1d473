"""Lorenz-63: three coupled quantities, the first system seen to be chaotic."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.quantities import Ratio
from kedge.core.registry import vehicles
from kedge.vehicles.benchmarks.autonomous import AbstractAutonomous, values_of

State = values_of(3)


@vehicles.add("lorenz63")
class Lorenz63(AbstractAutonomous):
    r"""Convection cut down to three modes.

    $\dot x = \sigma (y - x),\quad \dot y = x (\rho - z) - y,\quad \dot z = x y - \beta z$,
    each with white noise added.

    Chaotic for the defaults. Runge-Kutta steps should be no longer than 0.01: where readings
    are 0.25 apart and nothing else happens between them, give 25 ``substeps``. The state
    starts close to the attractor.

    Source: E. Lorenz, "Deterministic nonperiodic flow", J. Atmos. Sci. 20, 1963, section 7.
    """

    prandtl: Ratio = 10.0
    rayleigh: Ratio = 28.0
    aspect: Ratio = 8 / 3

    def flow(self, x: Float[Array, " n"]) -> Float[Array, " n"]:
        convection, horizontal, vertical = x
        return jnp.stack(
            [
                self.prandtl * (horizontal - convection),
                convection * (self.rayleigh - vertical) - horizontal,
                convection * horizontal - self.aspect * vertical,
            ]
        )

    def start(self) -> Any:
        return State(jnp.array([1.509, -1.531, 25.46]))
