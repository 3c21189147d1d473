"""Finite-size ensemble Kalman filter: inflation that follows from the ensemble's size."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.ensemble.transform import AbstractTransform
from kedge.numerics.gram import Gram

LARGEST = 100.0
"""Up to here the prior inflation is searched for."""
POINTS, ROUNDS = 33, 3


@filters.add("enkf-n")
class FiniteSizeEnsembleKalman(AbstractTransform):
    r"""A transform filter that knows its moments to be those of a sample of N members.

    With the true moments integrated out, the prior anomalies are to be multiplied by the
    $\lambda$ that minimises the dual cost
    $D(\lambda) = d^\top (I + \lambda^2 Y Y^\top)^{-1} d + (N - 1)\,\epsilon / \lambda^2 +
    c \ln \lambda^2$ with $\epsilon = 1 + 1/N$ and $c = N$, both shifted so that a reading that
    says nothing asks for $\lambda = 1$; then follows the update of ``etkf``. So inflation need
    not be tuned, as long as the model is right; ``inflation`` comes on top of it, for models
    that are not.

    One parameter for the whole ensemble, or for each neighbourhood with a ``radius``. The
    minimum is looked for up to 100 on a grid that is refined, then by Newton's method. The
    dependence of $\lambda$ on the mean's weights is left out of the anomalies' Hessian, as is
    usual. The innovation that is reported is that of the anomalies before.

    ``certainty`` multiplies the weight of the prior on $\lambda$: 1 for what follows from N
    alone, about 2 for models so nearly linear that the sample is better than a random one.

    Source: M. Bocquet, "Ensemble Kalman filtering without the intrinsic need for inflation",
    Nonlin. Processes Geophys. 18, 2011; M. Bocquet, P. Sakov, "Combining inflation-free and
    iterative ensemble Kalman filters for strongly nonlinear systems", ibid. 19, 2012 (dual
    form); M. Bocquet, P. Raanes, A. Hannart, "Expanding the validity of the ensemble Kalman
    filter without the intrinsic need for inflation", ibid. 22, 2015 (mode of the prior).
    """

    certainty: Scalar = 1.0

    def __check_init__(self):
        if isinstance(self.certainty, int | float) and not self.certainty > 0:
            raise ContractError(f"enkf-n: certainty is {self.certainty:g}, must be above 0")

    def prior_inflation(
        self, eigen: Gram, squares: Float[Array, " k"]
    ) -> Float[Array, ""] | float:
        """Where the dual cost is least."""
        count, values = eigen.factor.shape[1], eigen.values
        epsilon, weight = (count - 1) * (1 + 1 / count), float(count)
        # Where the reading says nothing the mode is to be 1, not below.
        uninformed = (jnp.sum(1 / (1 + values)) + count - values.shape[0]) / count
        shift = jnp.sqrt((epsilon / weight) ** uninformed)
        epsilon, weight = self.certainty * epsilon / shift, self.certainty * weight * shift

        def cost(log_square):
            square = jnp.exp(log_square)
            fit = jnp.sum(squares[None] / (1 + square[:, None] * values[None]), axis=1)
            return fit + epsilon / square + weight * log_square

        low = jnp.log(epsilon / weight)
        high = jnp.full((), 2 * jnp.log(LARGEST), low.dtype)
        for _ in range(ROUNDS):
            grid = low + (high - low) * jnp.linspace(0.0, 1.0, POINTS, dtype=low.dtype)
            best = jnp.argmin(cost(grid))
            low, high = grid[jnp.maximum(best - 1, 0)], grid[jnp.minimum(best + 1, POINTS - 1)]

        # A minimum is flat, so only the root of the slope is known to all digits.
        best = (low + high) / 2
        for _ in range(ROUNDS):
            square = jnp.exp(best)
            ratio = 1 + square * values
            pull = squares * square * values / ratio**2
            slope = weight - epsilon / square - jnp.sum(pull)
            bend = epsilon / square - jnp.sum(pull * (2 - ratio) / ratio)
            newton = best - slope / jnp.where(bend > 0, bend, jnp.inf)
            best = jnp.clip(newton, low, high)
        return jnp.exp(best / 2)
