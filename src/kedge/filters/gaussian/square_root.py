"""Square-root form of any Gaussian filter: the covariance is never formed, only its root."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian, stretch
from kedge.core.contracts import (
    AbstractFilter,
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import considered_of, space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.recursion import AbstractMomentFilter, expectation_of, motion, moved
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import solve_lower, square_root, triangularise
from kedge.numerics.noise import process_std


class SqrtGaussian(NamedTuple):
    """Normal distribution by a root of its covariance, ``cov == root @ root.T``."""

    mean: Any
    root: Float[Array, "*batch n n"]

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(self.mean, self.root @ jnp.swapaxes(self.root, -1, -2))

    def inflated(self, factor: Scalar) -> Any:
        """The same mean, the covariance times ``factor`` but for augmented states."""
        grown = jnp.broadcast_to(stretch(self.mean, factor), self.root.shape[-1:])
        return self._replace(root=self.root * jnp.broadcast_to(grown[:, None], self.root.shape))


@filters.add("square-root")
class SquareRootKalman(AbstractGaussianFilter):
    r"""The filter ``inner`` on roots of covariances, by orthogonal triangularisation.

    With deviations E before and A after as ``inner`` makes them,
    $P'^{1/2} Q = A$ at a prediction, and at an update
    $\begin{pmatrix} S^{1/2} & 0 \\ K S^{1/2} & P'^{1/2} \end{pmatrix} Q =
    \begin{pmatrix} A & R^{1/2} \\ E & 0 \end{pmatrix}$ with an orthogonal Q.
    A root has half the digits to carry, so a spread of variances beyond what the floats can
    hold is still represented, in 32 bits above all, and no covariance is ever indefinite.

    ``inner`` is kalman, extended, unscented, cubature or gauss-hermite, without negative
    weights.

    Source: P. Kaminski, A. Bryson, S. Schmidt, "Discrete square root filtering: a survey of
    current techniques", IEEE Trans. Autom. Control 16(6), 1971; R. van der Merwe and E. Wan,
    "The square-root unscented Kalman filter for state and parameter estimation", ICASSP 2001.
    """

    inner: AbstractFilter = ExtendedKalman()

    def __check_init__(self):
        if not isinstance(self.inner, AbstractMomentFilter):
            raise ContractError(
                f"square-root: inner is {type(self.inner).__name__}, must be one of kalman, "
                "extended, unscented, cubature, gauss-hermite"
            )
        if self.inner.strategy().signed:
            raise ContractError(
                f"square-root: inner is {self.inner}, whose sigma points can have negative "
                "weights, and these have no root; choose alpha, beta and kappa without (the "
                "defaults), or 'cubature'"
            )

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """Mean and root of the prior."""
        del key
        return SqrtGaussian(prior.mean, square_root(prior.cov))

    def considers(self) -> bool:
        """The inner filter's."""
        return self.inner.considers()

    def transition(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar
    ) -> tuple[Any, Float[Array, "n n"]]:
        """Triangularise the deviations after the step."""
        step = motion(vehicle, belief.mean, control, dt)
        std = process_std(vehicle, dt).astype(belief.root.dtype)
        factors = self._moments().strategy().factors(step, belief.root, std)
        return (
            SqrtGaussian(factors.mean, triangularise(factors.after)),
            factors.before @ factors.after.T,
        )

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """Triangularise the joint deviations of measurement and state."""
        del key
        expect = expectation_of(model, belief.mean)
        factors = self._moments().strategy().factors(expect, belief.root)
        residual = (
            space(factors.mean).boxminus(measurement, factors.mean).astype(factors.after.dtype)
        )
        size = residual.shape[0]
        noise = square_root(model.noise_cov(belief.mean).astype(belief.root.dtype))
        none = jnp.zeros((belief.root.shape[0], size), noise.dtype)
        joint = triangularise(jnp.block([[factors.after, noise], [factors.before, none]]))
        S_root, scaled_gain = joint[:size, :size], joint[size:, :size]
        white = solve_lower(S_root, residual)
        considered = np.asarray(considered_of(type(belief.mean)))
        root = joint[size:, size:]
        if considered.any():
            # What the gain leaves out of the considered states stays in their root.
            left_out = jnp.where(considered[:, None], scaled_gain, 0.0)
            scaled_gain = scaled_gain - left_out
            root = triangularise(jnp.concatenate([left_out, root], axis=1))
        mean, turn = moved(belief.mean, scaled_gain @ white)
        posterior = SqrtGaussian(mean, root if turn is None else turn @ root)
        return posterior, innovation(residual, S_root @ S_root.T, S_root, model.dof())

    def _moments(self) -> AbstractMomentFilter:
        assert isinstance(self.inner, AbstractMomentFilter)  # since construction
        return self.inner
