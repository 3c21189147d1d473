"""The recursion that all filters with one Gaussian share; they differ by their strategy.

Noise is not added to the state but goes through the vehicle's step, and errors live in the
tangent space at the mean: on a Euclidean state this is the textbook filter, on a manifold the
error-state filter.
"""

import abc
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian, inflated_cov
from kedge.core.contracts import (
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.manifolds import considered_of, space
from kedge.core.quantities import Scalar
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky, gain, mirrored
from kedge.numerics.noise import process_std
from kedge.numerics.propagation import AbstractPropagation, Function


class RepairedGaussian(NamedTuple):
    """A normal distribution, and the repairs of its covariance that no update has told yet."""

    mean: Any
    cov: Float[Array, "*batch n n"]
    repairs: Int[Array, "*batch"]

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def inflated(self, factor: Scalar) -> Any:
        """The same mean, the covariance times ``factor`` but for augmented states."""
        return self._replace(cov=inflated_cov(self.mean, self.cov, factor))


class AbstractMomentPrediction(AbstractGaussianFilter):
    """A Gaussian filter that predicts by pushing moments through the vehicle's step."""

    @abc.abstractmethod
    def strategy(self) -> AbstractPropagation:
        """How a Gaussian is pushed through the vehicle and the sensor."""

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """The prior; with a count of repairs if the strategy can make them necessary."""
        del key
        if self.strategy().signed:
            return RepairedGaussian(prior.mean, prior.cov, jnp.zeros((), int))
        return prior

    def transition(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar
    ) -> tuple[Any, Float[Array, "n n"]]:
        """Push the belief and the process noise through the vehicle's step."""
        step = motion(vehicle, belief.mean, control, dt)
        std = process_std(vehicle, dt).astype(belief.cov.dtype)
        moments = self.strategy().propagated(step, belief.cov, std)
        after = belief._replace(mean=moments.mean, cov=moments.cov)
        if isinstance(after, RepairedGaussian):
            after = after._replace(repairs=after.repairs + moments.repairs)
        return after, moments.cross


class AbstractMomentFilter(AbstractMomentPrediction):
    r"""Match moments, then condition the joint Gaussian of state and measurement.

    $K = P_{xz} S^{-1}$, $x^+ = x \boxplus K (z \boxminus \hat z)$,
    $P^+ = \mathrm{Cov}(x - K z) + K R K^\top$.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 5.2 (the Joseph form).
    """

    def considers(self) -> bool:
        """It does."""
        return True

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """Condition on one measurement."""
        del key
        moments = self.strategy().propagated(expectation_of(model, belief.mean), belief.cov)
        noise_cov = jnp.asarray(model.noise_cov(belief.mean), belief.cov.dtype)
        cov = mirrored(moments.cov + noise_cov)
        root = cholesky(cov)
        K = corrected(belief.mean, gain(moments.cross, root))
        residual = space(moments.mean).boxminus(measurement, moments.mean).astype(cov.dtype)
        after, clipped = moments.semidefinite(moments.posterior(K, noise_cov))
        repairs = moments.repairs + clipped
        mean, turn = moved(belief.mean, K @ residual)
        posterior = belief._replace(mean=mean, cov=turned(turn, after))
        if isinstance(belief, RepairedGaussian):
            repairs = repairs + belief.repairs
            posterior = posterior._replace(repairs=jnp.zeros_like(belief.repairs))
        score = innovation(residual, cov, root, model.dof())
        return posterior, score._replace(repairs=repairs)


def motion(vehicle: AbstractVehicle, mean: Any, control: Any, dt: Scalar) -> Function:
    """The vehicle's step as a function of the error about ``mean`` and of the noise."""
    states, noises = space(mean), space(vehicle.noise_density())

    def step(error: Float[Array, " n"], noise: Float[Array, " w"]) -> Any:
        state = states.boxplus(mean, error)
        return vehicle.step(state, control, noises.unflatten(noise), dt)

    return step


def expectation_of(model: AbstractMeasurementModel, mean: Any) -> Function:
    """The expected measurement as a function of the error about ``mean``."""
    states = space(mean)
    return lambda error: model.expect(states.boxplus(mean, error))


def corrected(mean: Any, K: Float[Array, "n m"]) -> Float[Array, "n m"]:
    r"""A gain without the rows of the states that are considered only.

    Joseph's form, $P^+ = (I - K H) P (I - K H)^\top + K R K^\top$, is right for any gain: what
    the gain leaves out stays in the covariance.

    Source: S. Schmidt, "Application of state-space methods to navigation problems", Advances in
    Control Systems 3, 1966; G. Bierman, "Factorization Methods for Discrete Sequential
    Estimation", 1977, section VIII.2.
    """
    considered = considered_of(type(mean))
    if not any(considered):
        return K
    return jnp.where(np.asarray(considered)[:, None], 0.0, K)


def moved(mean: Any, shift: Float[Array, " n"]) -> tuple[Any, Float[Array, "n n"] | None]:
    """The mean after a correction, and what turns errors about the old one into those about it.

    None where every chart is flat, since nothing turns there.
    """
    states = space(mean)
    return states.boxplus(mean, shift), states.slope(shift)


def turned(turn: Float[Array, "n n"] | None, cov: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """A covariance of errors about the old mean as one about the new mean."""
    return cov if turn is None else mirrored(turn @ cov @ turn.T)
