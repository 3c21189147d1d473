"""What wrappers share that learn each sensor's noise from its innovations."""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter, AbstractMeasurementModel, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.filters.wrappers.wrapper import AbstractWrapper


class Adapted(NamedTuple):
    """The inner filter's belief, and what was learned of each sensor's noise."""

    belief: Any
    factor: dict[str, Float[Array, ""]]
    """What R is multiplied by, by sensor."""
    ratio: dict[str, Float[Array, ""]]
    """Average NIS by its expectation, by sensor; empty for learners that keep none."""

    def moments(self) -> Gaussian:
        """The inner belief's."""
        return self.belief.moments()

    def inflated(self, factor: Scalar) -> "Adapted":
        """The inner belief widened; what was learned stays."""
        return self._replace(belief=self.belief.inflated(factor))


class AbstractNoiseLearner(AbstractWrapper):
    """Multiplies each sensor's R by a factor between ``floor`` and ``ceiling``.

    ``window`` is about how many readings it takes to learn.

    Raises:
        ContractError: a window below 1, or bounds that are not in order.
    """

    window: Scalar = 30.0
    floor: Scalar = 0.01
    ceiling: Scalar = 100.0
    sources: tuple[str, ...] = eqx.field(static=True, default=("",))

    title: ClassVar[str]
    """Name of the wrapper in messages."""

    def __check_init__(self):
        numbers = self.window, self.floor, self.ceiling
        if not all(isinstance(number, int | float) for number in numbers):
            return  # arrays, made from numbers that were checked
        if not self.window >= 1:
            raise ContractError(f"{self.title}: window is {self.window:g}, must be at least 1")
        if not 0 < self.floor <= self.ceiling:
            raise ContractError(
                f"{self.title}: floor is {self.floor:g} and ceiling {self.ceiling:g}; expected "
                "0 < floor <= ceiling"
            )

    def bind_sensors(self, sources: tuple[str, ...]) -> AbstractFilter:
        """Remember one factor for each sensor."""
        return dataclasses.replace(super().bind_sensors(sources), sources=sources)

    def unwrap(self, belief: Any) -> Any:
        """Without what was learned."""
        return belief.belief

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Adapted:
        """The inner filter's belief, and every sensor's noise as it says."""
        ones = {name: jnp.ones(()) for name in self.sources}
        return Adapted(self.inner.init(prior, key), ones, {})

    def predict(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> Adapted:
        """The inner filter's prediction."""
        predicted = self.inner.predict(vehicle, belief.belief, control, dt, key)
        return belief._replace(belief=predicted)

    def source_of(self, model: AbstractMeasurementModel, belief: Adapted) -> str:
        """Name of the sensor that speaks.

        Raises:
            ContractError: it was not announced.
        """
        name = model.source()
        if name not in belief.factor:
            raise ContractError(
                f"{self.title}: it hears of the sensor {name!r}, but was told of "
                f"{self.sources}; call aboard() with the sensors' names, as the drivers do"
            )
        return name
