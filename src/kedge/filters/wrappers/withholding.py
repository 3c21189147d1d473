"""A filter that judges the readings of every second window of time, and does not use them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractMeasurementModel, AbstractVehicle, Innovation
from kedge.core.quantities import Scalar
from kedge.filters.wrappers.wrapper import AbstractWrapper

EARLY = 1e-6
"""s before its time at which a window begins, so that sums of steps agree with times."""


class Timed(NamedTuple):
    """The inner filter's belief, and how long it has been predicted."""

    belief: Any
    time: Float[Array, ""]

    def moments(self) -> Gaussian:
        """The inner belief's."""
        return self.belief.moments()


class Withholding(AbstractWrapper):
    """Predicts through every second window of ``horizon`` s; readings in it change nothing.

    Their innovations are those of the filter ``inner``, which holds nothing newer than the
    window's beginning. The phases 0 and 1 share the time between them, but for the first
    window, in which a belief is made out of the prior.
    """

    horizon: Scalar = 1.0
    phase: Scalar = 0.0

    def unwrap(self, belief: Any) -> Any:
        """Without the time."""
        return belief.belief

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Timed:
        """The inner filter's belief."""
        return Timed(self.inner.init(prior, key), jnp.zeros(()))

    def predict(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> Timed:
        """The inner filter's prediction."""
        predicted = self.inner.predict(vehicle, belief.belief, control, dt, key)
        return Timed(predicted, belief.time + dt)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Timed, Innovation]:
        """The inner filter's, undone within a window."""
        posterior, score = self.inner.update(model, belief.belief, measurement, key)
        held = self.holds_back(belief.time)
        kept = jax.tree.map(
            lambda new, old: jnp.where(held, old, new), posterior, belief.belief
        )
        return Timed(kept, belief.time), score

    def holds_back(self, time: Float[Array, "*T"]) -> Bool[Array, "*T"]:
        """Whether a time, in s, lies in a window."""
        window = jnp.floor((time + EARLY) / self.horizon)
        return (jnp.mod(window, 2) == self.phase) & (window > 0)
