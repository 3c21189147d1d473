"""A gate around any filter: readings too unlikely under the prediction change nothing."""

from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray
from scipy.special import chdtri

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

B = TypeVar("B")


@filters.add("gated")
class Gated(AbstractFilter[Any]):
    r"""A gate around the filter ``inner``, set by its false-alarm probability.

    Accepts a reading if $\nu^\top S^{-1} \nu \le \chi^2_d(1 - \alpha)$.

    ``false_alarm`` is $\alpha$, the share of good readings refused if the model is right; the
    bound follows from it and from the number d of components present, so a reading that is
    partly missing is judged by what is there.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 5.7.2.
    """

    inner: AbstractFilter = ExtendedKalman()
    false_alarm: float = eqx.field(static=True, default=0.01)

    def __check_init__(self):
        if not 0 < self.false_alarm < 1:
            raise ContractError(
                f"gate: false_alarm is {self.false_alarm:g}, must be between 0 and 1; it is "
                "the probability of refusing a good reading, e.g. 0.01"
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
        """The inner filter's update, undone if the reading falls outside the gate."""
        posterior, score = self.inner.update(model, belief, measurement, key)
        sizes = np.arange(score.residual.shape[0] + 1)
        bounds = np.where(sizes > 0, chdtri(np.maximum(sizes, 1), self.false_alarm), np.inf)
        # What the inner filter has left out already keeps the inner filter's reason.
        taken = jnp.asarray(score.accepted)
        own = jnp.minimum(jnp.asarray(bounds)[score.dof], score.threshold)
        threshold = jnp.where(taken, own, score.threshold)
        inside = score.nis <= threshold
        kept = jax.tree.map(lambda new, old: jnp.where(inside, new, old), posterior, belief)
        return kept, score._replace(accepted=taken & inside, threshold=threshold)
