"""Posterior linearisation filter: sigma points where the state is now thought to be."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.errors import ContractError
from kedge.core.registry import filters
from kedge.filters.gaussian.relinearisation import AbstractRelinearised, check_iterations
from kedge.numerics.linalg import cholesky
from kedge.numerics.propagation import SigmaPoints
from kedge.numerics.quadrature import cubature, gauss_hermite, unscented

RULES = {"cubature": cubature, "gauss-hermite": gauss_hermite, "unscented": unscented}


@filters.add("posterior-linearisation")
class PosteriorLinearisation(AbstractRelinearised):
    """Statistical linear regression of the sensor over the posterior, ``iterations`` times.

    A sigma-point filter chooses its line over the prior, where the state no longer is once a
    good reading has come. Here the line is chosen again over the posterior found, with what it
    leaves unexplained as noise. ``rule`` names the points: cubature, gauss-hermite (of third
    order) or unscented (with its defaults). One iteration without ``halvings`` is the filter
    of that rule.

    Source: Á. García-Fernández, L. Svensson, M. Morelande, S. Särkkä, "Posterior linearization
    filter: principles and implementation using sigma points", IEEE Trans. Signal Process.
    63(20), 2015.
    """

    rule: str = eqx.field(static=True, default="cubature")
    iterations: int = eqx.field(static=True, default=4)
    halvings: int = eqx.field(static=True, default=4)

    def __check_init__(self):
        check_iterations("posterior-linearisation", self.iterations, self.halvings)
        if self.rule not in RULES:
            raise ContractError(
                f"posterior-linearisation: rule is {self.rule!r}, must be one of "
                f"{', '.join(RULES)}"
            )

    def strategy(self) -> SigmaPoints:
        """The points of the rule."""
        return SigmaPoints(RULES[self.rule])

    def around(self, cov: Float[Array, "n n"]) -> Float[Array, "n n"]:
        """The posterior's spread, a little more where nothing is left of the prior's."""
        # A line through points that coincide has no slope; at 1e-4 of the prior's spread
        # (float64) it is the tangent to rounding.
        floor = jnp.finfo(cov.dtype).eps ** 0.5
        return cholesky(cov + floor * jnp.eye(cov.shape[0], dtype=cov.dtype))
