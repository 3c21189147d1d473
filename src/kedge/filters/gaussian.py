"""The recursion that all filters with one Gaussian share; they differ by their strategy.

Noise is not added to the state but goes through the vehicle's step, and errors live in the
tangent space at the mean: on a Euclidean state this is the textbook filter, on a manifold the
error-state filter.
"""

import abc
from typing import Any

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
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky, gain, symmetric
from kedge.numerics.noise import process_std
from kedge.numerics.propagation import AbstractPropagation


class AbstractMomentFilter(AbstractGaussianFilter):
    r"""Match moments, then condition the joint Gaussian of state and measurement.

    $K = P_{xz} S^{-1}$, $x^+ = x \boxplus K (z \boxminus \hat z)$,
    $P^+ = \mathrm{Cov}(x - K z) + K R K^\top$.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 5.2 (the Joseph form).
    """

    @abc.abstractmethod
    def strategy(self) -> AbstractPropagation:
        """How a Gaussian is pushed through the vehicle and the sensor."""

    def transition(
        self, vehicle: AbstractVehicle, belief: Gaussian, control: Any, dt: Scalar
    ) -> tuple[Gaussian, Float[Array, "n n"]]:
        """Push the belief and the process noise through the vehicle's step."""
        states, noises = space(belief.mean), space(vehicle.noise_density())

        def step(error, noise):
            state = states.boxplus(belief.mean, error)
            return vehicle.step(state, control, noises.unflatten(noise), dt)

        image = self.strategy().image(step, belief.cov, process_std(vehicle, dt))
        return Gaussian(image.mean, symmetric(image.cov)), image.cross

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Gaussian,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Gaussian, Innovation]:
        """Condition on one measurement."""
        del key
        states = space(belief.mean)
        image = self.strategy().image(
            lambda error: model.expect(states.boxplus(belief.mean, error)), belief.cov
        )
        noise_cov = model.noise_cov(belief.mean)
        cov = symmetric(image.cov + noise_cov)
        root = cholesky(cov)
        K = gain(image.cross, root)
        residual = space(image.mean).boxminus(measurement, image.mean)
        posterior = Gaussian(
            mean=states.boxplus(belief.mean, K @ residual),
            cov=symmetric(image.remainder(K) + K @ noise_cov @ K.T),
        )
        return posterior, innovation(residual, cov, root, model.dof())
