"""Raw readings: the baseline that believes each reading as it is."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import (
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.recursion import corrected, expectation_of, moved, turned
from kedge.numerics.linalg import cholesky, gain, symmetric
from kedge.numerics.propagation import Taylor


@filters.add("raw")
class Raw(AbstractGaussianFilter):
    r"""Predicts like the extended filter, and takes over what is measured.

    The state moves by the shortest way to where the reading is expected exactly,
    $K = H^\top (H H^\top)^{-1}$, whatever was believed before: a measured velocity or position
    replaces the one believed, and what is not measured stays. Its covariance is that of this
    rule. Its innovations are the extended filter's.

    Source: A. Gelb, "Applied Optimal Estimation", 1974, section 4.2 (the limit of a gain
    without knowledge beforehand).
    """

    def considers(self) -> bool:
        """It does."""
        return True

    def transition(
        self, vehicle: AbstractVehicle, belief: Gaussian, control: Any, dt: Scalar
    ) -> tuple[Gaussian, Float[Array, "n n"]]:
        """The extended filter's prediction."""
        return ExtendedKalman().transition(vehicle, belief, control, dt)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Gaussian,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Gaussian, Innovation]:
        """Take over the reading."""
        _, score = ExtendedKalman().update(model, belief, measurement, key)
        unit = jnp.eye(belief.cov.shape[0], dtype=belief.cov.dtype)
        factors = Taylor().factors(expectation_of(model, belief.mean), unit)
        H, expected = factors.after, factors.mean
        # A component that is missing has no slope: it must not be divided by.
        none = jnp.all(H == 0, axis=1)
        free = corrected(belief.mean, H.T)
        K = gain(free, cholesky(symmetric(free.T @ free) + jnp.diag(jnp.where(none, 1.0, 0.0))))
        residual = space(expected).boxminus(measurement, expected)
        mean, turn = moved(belief.mean, K @ residual)
        complement = unit - K @ H
        R = model.noise_cov(belief.mean)
        cov = symmetric(complement @ belief.cov @ complement.T + K @ R @ K.T)
        return Gaussian(mean, turned(turn, cov)), score
