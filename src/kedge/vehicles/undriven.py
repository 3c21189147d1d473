"""A motion model that heeds no control, where there is one."""

from typing import Any

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import Scalar


class Undriven(AbstractVehicle[Any, Any, Any]):
    """``vehicle``, told of the controls of ``driven`` and going its own way.

    So a kinematic model, which nobody drives, can be compared on the log of a vehicle that is.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.2 (kinematic models: the input is taken for noise).
    """

    vehicle: AbstractVehicle
    driven: AbstractVehicle

    def step(self, state: Any, control: Any, noise: Any, dt: Scalar) -> Any:
        return self.vehicle.step(state, self.vehicle.nominal_control(0.0), noise, dt)

    def noise_density(self) -> Any:
        return self.vehicle.noise_density()

    def start(self) -> Any:
        return self.vehicle.start()

    def nominal_control(self, time: Scalar) -> Any:
        return self.driven.nominal_control(time)

    def longest_step(self) -> float:
        return self.vehicle.longest_step()
