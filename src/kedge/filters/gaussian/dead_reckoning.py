"""Dead reckoning: the baseline that every estimate has to beat."""

from typing import Any

from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import (
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.gaussian.extended import ExtendedKalman


@filters.add("dead-reckoning")
class DeadReckoning(AbstractGaussianFilter):
    """Predicts like the extended filter and takes in no reading; each gets DROPPED.

    Its innovations are computed all the same, so residuals show what a reading would have said.

    Source: S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics", 2005, section 5.4.
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
        """Score the reading, keep the belief."""
        _, score = ExtendedKalman().update(model, belief, measurement, key)
        return belief, score._replace(accepted=False)
