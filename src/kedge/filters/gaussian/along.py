"""A Gaussian filter that linearises along a given trajectory, to find a more probable one."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import (
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.filters.gaussian.recursion import corrected, expectation_of, motion
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky, gain, square_root, symmetric
from kedge.numerics.losses import Loss
from kedge.numerics.noise import process_std
from kedge.numerics.propagation import AbstractPropagation, Function, Taylor


class Along(NamedTuple):
    """A normal distribution of the errors about a point of the trajectory."""

    point: Any
    error: Float[Array, "*batch n"]
    cov: Float[Array, "*batch n n"]
    number: Int[Array, "*batch"]
    """Of the point: how many predictions led to it."""
    cost: Float[Array, "*batch"]
    """Of the trajectory so far."""

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(space(self.point).boxplus(self.point, self.error), self.cov)

    def inflated(self, factor: Scalar) -> Any:
        """The same: a trajectory is not doubted."""
        del factor
        return self


class LinearisedAlong(AbstractGaussianFilter):
    r"""Models are linearised at ``points``, by number of predictions, not at its own means.

    Everything is in the charts at these points: with $e_k = x_k \boxminus \bar x_k$

    $e_{k+1} = (f(\bar x_k) \boxminus \bar x_{k+1}) + F e_k + w,\quad
    z \boxminus h(\bar x_k) = H e_k + v$,

    so that the smoother of this filter minimises the quadratic model of the trajectory's cost,
    one step of Gauss and Newton, at singular process noise too. On the way the cost of the
    points themselves adds up: the prior's, $|f(\bar x_k) \boxminus \bar x_{k+1}|^2_{Q^+}$ of
    each step and the loss of each reading under R, twice the negative log posterior density
    but for what does not depend on them.

    ``spreads`` are the covariances over which strategies with points linearise.

    Source: B. Bell, "The iterated Kalman smoother as a Gauss-Newton method", SIAM J.
    Optimization 4(3), 1994; Á. García-Fernández, L. Svensson, S. Särkkä, "Iterated posterior
    linearization smoother", IEEE Trans. Automatic Control 62(4), 2017.
    """

    points: Any
    spreads: Float[Array, "T n n"]
    strategy: AbstractPropagation = Taylor()
    loss: Loss | None = None

    def weighing(self, loss: Loss | None) -> "LinearisedAlong":
        """With a loss that weighs each reading by its residual at the trajectory, under R."""
        return eqx.tree_at(lambda f: f.loss, self, loss, is_leaf=lambda leaf: leaf is None)

    def considers(self) -> bool:
        """It does."""
        return True

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Along:
        """The prior about the first point."""
        del key
        first = self._point(jnp.zeros((), int))
        error = space(first).boxminus(prior.mean, first)
        cost = _weighed(square_root(prior.cov), error)
        return Along(first, error, prior.cov, jnp.zeros((), int), cost)

    def transition(
        self, vehicle: AbstractVehicle, belief: Along, control: Any, dt: Scalar
    ) -> tuple[Along, Float[Array, "n n"]]:
        """Along the chord to the next point."""
        after = self._point(belief.number + 1)
        step = motion(vehicle, belief.point, control, dt)
        std = process_std(vehicle, dt).astype(belief.cov.dtype)
        value, F, effect = self._linear(step, belief.number, std)
        defect = space(after).boxminus(value, after)
        cross = belief.cov @ F.T
        return (
            Along(
                after,
                defect + F @ belief.error,
                symmetric(F @ cross + effect @ effect.T),
                belief.number + 1,
                belief.cost + _weighed(effect, defect),
            ),
            cross,
        )

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Along,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Along, Innovation]:
        """Condition on one reading, weighed by its residual at the point."""
        del key
        value, H, effect = self._linear(expectation_of(model, belief.point), belief.number)
        residual = space(value).boxminus(measurement, value).astype(belief.cov.dtype)
        noise = jnp.asarray(model.noise_cov(belief.point), belief.cov.dtype)
        factor, cost = jnp.ones(()), _weighed(cholesky(noise), residual)
        if self.loss is not None:
            factor = self.loss.factor(residual, noise, model.dof())
            cost = self.loss.cost(residual, noise, model.dof())
        R = factor * noise + effect @ effect.T
        S = symmetric(H @ belief.cov @ H.T + R)
        root = cholesky(S)
        K = corrected(belief.point, gain(belief.cov @ H.T, root))
        off = residual - H @ belief.error
        kept = jnp.eye(belief.cov.shape[0], dtype=belief.cov.dtype) - K @ H
        posterior = belief._replace(
            error=belief.error + K @ off,
            cov=symmetric(kept @ belief.cov @ kept.T + K @ R @ K.T),
            cost=belief.cost + cost,
        )
        return posterior, innovation(off, S, root, model.dof())

    def _point(self, number: Int[Array, ""]) -> Any:
        return jax.tree.map(lambda leaf: leaf[number], self.points)

    def _linear(
        self,
        function: Function,
        number: Int[Array, ""],
        noise_std: Float[Array, " w"] | None = None,
    ) -> tuple[Any, Float[Array, "m n"], Float[Array, "m k"]]:
        """The value at a point, the slope, and a root of what is not linear in the error."""
        spread = self.spreads[number]
        one = jnp.eye(spread.shape[0], dtype=spread.dtype)
        # A derivative needs no spread. That of a state which is known exactly has no inverse.
        root = one if self.strategy.affine else square_root(spread + 1e-12 * _floor(spread))
        factors = self.strategy.factors(function, root, noise_std)
        slope = gain(factors.after @ factors.before.T, root)
        return factors.mean, slope, factors.after - slope @ factors.before


def _floor(cov: Float[Array, "n n"]) -> Float[Array, "n n"]:
    return jnp.diag(jnp.diag(cov) + 1e-300)


def _weighed(root: Float[Array, "n k"], error: Float[Array, " n"]) -> Float[Array, ""]:
    """The square of what has to be drawn for an error, in the directions that are drawn."""
    drawn = jnp.linalg.pinv(root, rtol=1e-9) @ error
    return drawn @ drawn
