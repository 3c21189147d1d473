"""What filters around another filter share."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray
from scipy.special import chdtri

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
    Ranging,
)
from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.filters.gaussian.extended import ExtendedKalman

RECOVERY = 10.0
"""s of nothing but outliers of a sensor after which the belief is doubted, not the sensor."""
FALSE_ALARM = 0.01
"""Share of good readings that are taken for outliers if the model is right."""


class AbstractWrapper(AbstractFilter[Any]):
    """A filter around the filter ``inner``, which changes its updates."""

    inner: AbstractFilter = ExtendedKalman()

    def bind_sensors(self, sources: tuple[str, ...]) -> AbstractFilter:
        """Pass it on."""
        return eqx.tree_at(
            lambda wrapper: wrapper.inner, self, self.inner.bind_sensors(sources)
        )

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """The inner filter's belief."""
        return self.inner.init(prior, key)

    def predict(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> Any:
        """The inner filter's prediction."""
        return self.inner.predict(vehicle, belief, control, dt, key)

    def recovery_time(self) -> float:
        """The inner filter's."""
        return self.inner.recovery_time()

    def considers(self) -> bool:
        """The inner filter's."""
        return self.inner.considers()

    def trusting(self) -> AbstractFilter:
        """The same around the inner filter without its gates and robust losses."""
        return eqx.tree_at(lambda wrapper: wrapper.inner, self, self.inner.trusting())

    def reset(self, belief: Any, factor: Scalar) -> Any:
        """The inner filter's; what the wrapper itself keeps stays."""
        bare = self.unwrap(belief)
        inner = self.inner.reset(bare, factor)
        return inner if bare is belief else belief._replace(belief=inner)

    def unwrap(self, belief: Any) -> Any:
        """The inner filter's belief inside this one's."""
        return belief


class AbstractOutlierTest(AbstractWrapper):
    """A gate or a robust loss: what it takes for an outlier moves the belief little or not.

    It trusts the belief more than the reading. When the belief is what is wrong, good readings
    are outliers for ever; so after ``recovery`` seconds of nothing but outliers of a sensor the
    event step lets one in (:mod:`kedge.estimation.recovery`); infinity is never.
    """

    recovery: float = eqx.field(static=True, kw_only=True, default=RECOVERY)

    def __check_init__(self):
        if not self.recovery > 0:
            raise ContractError(
                f"{type(self).__name__}: recovery is {self.recovery:g} s, must be above 0; inf "
                "is never"
            )

    def recovery_time(self) -> float:
        """Its own, or the inner filter's if that is shorter."""
        return min(self.recovery, self.inner.recovery_time())

    def trusting(self) -> AbstractFilter:
        """The inner filter's."""
        return self.inner.trusting()


def bound_of(score: Innovation, false_alarm: float) -> Float[Array, ""]:
    r"""$\chi^2_d(1 - \alpha)$ for the d components that are present; infinite without any."""
    sizes = np.arange(score.residual.shape[0] + 1)
    bounds = np.where(sizes > 0, chdtri(np.maximum(sizes, 1), false_alarm), np.inf)
    return jnp.asarray(bounds)[score.dof]


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
