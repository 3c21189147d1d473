"""What filters around another filter share."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Ranging,
)
from kedge.core.quantities import Scalar
from kedge.filters.gaussian.extended import ExtendedKalman


class AbstractWrapper(AbstractFilter[Any]):
    """A filter around the filter ``inner``, which changes its updates."""

    inner: AbstractFilter = ExtendedKalman()

    def bind_sensors(self, sources: tuple[str, ...]) -> AbstractFilter:
        """Pass it on."""
        return eqx.tree_at(lambda own: own.inner, self, self.inner.bind_sensors(sources))

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """The inner filter's belief."""
        return self.inner.init(prior, key)

    def predict(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> Any:
        """The inner filter's prediction."""
        return self.inner.predict(vehicle, belief, control, dt, key)

    def regained(self, belief: Any, factor: Scalar) -> Any:
        """The inner filter's; what the wrapper itself keeps stays."""
        bare = self.unwrap(belief)
        inner = self.inner.regained(bare, factor)
        return inner if bare is belief else belief._replace(belief=inner)

    def unwrap(self, belief: Any) -> Any:
        """The inner filter's belief inside this one's."""
        return belief


class Inflated(AbstractMeasurementModel[Any]):
    """A measurement model with its noise covariance multiplied."""

    model: AbstractMeasurementModel
    factor: Scalar

    def expect(self, state: Any) -> Any:
        """As the model."""
        return self.model.expect(state)

    def noise_cov(self, state: Any) -> Float[Array, "m m"]:
        """The model's, multiplied."""
        return self.model.noise_cov(state) * self.factor

    def noise_variance(self, state: Any) -> Float[Array, " m"] | None:
        """The model's, multiplied."""
        variance = self.model.noise_variance(state)
        return None if variance is None else variance * self.factor

    def distances(self, state: Any) -> Float[np.ndarray, "m n"] | None:
        """As the model."""
        return self.model.distances(state)

    def ranging(self, state: Any) -> Ranging | None:
        """As the model."""
        return self.model.ranging(state)

    def dof(self) -> Int[Array, ""] | int:
        """As the model."""
        return self.model.dof()

    def source(self) -> str:
        """As the model."""
        return self.model.source()
