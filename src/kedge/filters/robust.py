"""Student-t noise around any filter: outliers are weighed down instead of cut off."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.extended import ExtendedKalman


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

    def dof(self) -> Int[Array, ""] | int:
        """As the model."""
        return self.model.dof()


@filters.add("robust")
class Robust(AbstractFilter[Any]):
    r"""Student-t noise around the filter ``inner``.

    Multiplies R by $\max(1, (\nu + d^2) / (\nu + m))$ before the update.

    $d^2$ is the normalised innovation squared of the m components there, and
    ``student_dof`` is $\nu$ of the Student-t distribution whose weights these are: 4 is
    heavy-tailed, 1e6 Gaussian. One pass, so the update stays straight-line. What is reported
    (NIS, likelihood) is the innovation under the nominal noise, so that gates and consistency
    tests keep their sense.

    Source: M. Roth, E. Özkan, F. Gustafsson, "A Student's t filter for heavy tailed process
    and measurement noise", ICASSP 2013.
    """

    inner: AbstractFilter = ExtendedKalman()
    student_dof: Scalar = 4.0

    def __check_init__(self):
        if isinstance(self.student_dof, (int, float)) and not self.student_dof > 0:
            raise ContractError(
                f"robust: student_dof is {self.student_dof:g}, must be above 0, e.g. 4"
            )

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """The inner filter's belief."""
        return self.inner.init(prior, key)

    def predict(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> Any:
        """The inner filter's prediction."""
        return self.inner.predict(vehicle, belief, control, dt, key)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """The inner filter's update with the noise that the residual calls for."""
        _, score = self.inner.update(model, belief, measurement, key)
        ratio = (self.student_dof + score.nis) / (self.student_dof + score.dof)
        factor = jnp.maximum(ratio, 1.0)
        posterior, _ = self.inner.update(Inflated(model, factor), belief, measurement, key)
        return posterior, score
