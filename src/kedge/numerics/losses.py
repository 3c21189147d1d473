"""Robust losses as weights: how much a reading's noise grows with its innovation."""

from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.numerics.linalg import cholesky, solve_lower

Kind = Literal["student", "huber", "cauchy", "geman-mcclure"]
Side = Literal["both", "positive", "negative"]

TUNING: dict[str, float] = {
    "student": 4.0,
    "huber": 1.345,
    "cauchy": 2.385,
    "geman-mcclure": 3.787,
}
"""Degrees of freedom of the Student-t; for the others the scale, in standard deviations, at
which a scalar estimate keeps 95 % of its efficiency if the noise is Gaussian after all."""


class Loss(eqx.Module):
    r"""The factor by which R is multiplied, from the normalised innovation squared $d^2$.

    ======================  ===========================================
    ``student`` ($\nu$)     $\max(1, (\nu + d^2) / (\nu + m))$
    ``huber`` ($c$)         $\max(1, d / c)$
    ``cauchy`` ($c$)        $1 + d^2 / c^2$
    ``geman-mcclure`` ($c$) $(1 + d^2 / c^2)^2$
    ======================  ===========================================

    With ``side`` "positive" only components of the innovation above zero count in $d^2$: a
    range by radio is too long when the line of sight is blocked, and never too short.

    Raises:
        ContractError: an unknown loss or side, or a tuning that is not above 0.

    Source: Z. Zhang, "Parameter estimation techniques: a tutorial with application to conic
    fitting", Image and Vision Computing 15(1), 1997, section 9.4 (weights); M. Roth, E. Özkan,
    F. Gustafsson, "A Student's t filter for heavy tailed process and measurement noise",
    ICASSP 2013 (Student-t).
    """

    kind: str = eqx.field(static=True, default="student")
    tuning: Scalar | None = None
    side: str = eqx.field(static=True, default="both")

    def __check_init__(self):
        for name, value, known in (
            ("loss", self.kind, get_args(Kind)),
            ("side", self.side, get_args(Side)),
        ):
            if value not in known:
                raise ContractError(f"{name} is {value!r}, must be one of {', '.join(known)}")
        if isinstance(self.tuning, int | float) and not self.tuning > 0:
            raise ContractError(
                f"tuning is {self.tuning:g}, must be above 0, e.g. {TUNING[self.kind]:g}"
            )

    def factor(
        self, residual: Float[Array, " m"], cov: Float[Array, "m m"], dof: Int[Array, ""] | int
    ) -> Float[Array, ""]:
        """What R is multiplied by for a residual whose covariance is ``cov``."""
        squared, tuning = self._squared(residual, cov), self._tuning()
        if self.kind == "student":
            return jnp.maximum((tuning + squared) / (tuning + dof), 1.0)
        ratio = squared / jnp.asarray(tuning) ** 2
        if self.kind == "huber":
            return jnp.sqrt(jnp.maximum(ratio, 1.0))
        return 1 + ratio if self.kind == "cauchy" else (1 + ratio) ** 2

    def cost(
        self, residual: Float[Array, " m"], cov: Float[Array, "m m"], dof: Int[Array, ""] | int
    ) -> Float[Array, ""]:
        r"""What the residual adds to the sum that is least at the most probable states.

        $\rho(d^2)$ with $\rho' = 1 / $ :meth:`factor` and $\rho(0) = 0$; without outliers it is
        $d^2$. Components on the side that is not weighed count as they are.
        """
        squared, tuning = self._squared(residual, cov), self._tuning()
        white = solve_lower(cholesky(cov), residual)
        as_they_are = white @ white - squared
        scale = jnp.asarray(tuning) ** 2
        if self.kind == "student":
            beyond = (tuning + dof) * jnp.log((tuning + squared) / (tuning + dof))
            weighed = jnp.where(squared <= dof, squared, dof + beyond)
        elif self.kind == "huber":
            weighed = jnp.where(
                squared <= scale, squared, 2 * jnp.sqrt(scale * squared) - scale
            )
        elif self.kind == "cauchy":
            weighed = scale * jnp.log1p(squared / scale)
        else:
            weighed = squared / (1 + squared / scale)
        return weighed + as_they_are

    def _tuning(self) -> Scalar:
        return TUNING[self.kind] if self.tuning is None else self.tuning

    def _squared(
        self, residual: Float[Array, " m"], cov: Float[Array, "m m"]
    ) -> Float[Array, ""]:
        if self.side == "positive":
            residual = jnp.maximum(residual, 0.0)
        if self.side == "negative":
            residual = jnp.minimum(residual, 0.0)
        white = solve_lower(cholesky(cov), residual)
        return white @ white
