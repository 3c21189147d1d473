"""Gate: a reading too far from the prediction is refused, by any filter."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray
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
from kedge.filters.wrappers.wrapper import AbstractWrapper


class Watched(NamedTuple):
    """The inner filter's belief, and for how long its readings have been refused."""

    belief: Any
    refused_for: Float[Array, ""]
    """s since the first refusal after the last reading that was fused; -1 if there was none."""

    def moments(self) -> Gaussian:
        """The inner belief's."""
        return self.belief.moments()

    def widened(self, factor: Scalar) -> "Watched":
        """The inner belief widened."""
        return self._replace(belief=self.belief.widened(factor))


@filters.add("gated")
class Gated(AbstractWrapper):
    r"""A gate around the filter ``inner``, set by its false-alarm probability.

    Accepts a reading if $\nu^\top S^{-1} \nu \le \chi^2_d(1 - \alpha)$.

    ``false_alarm`` is $\alpha$, the share of good readings refused if the model is right; the
    bound follows from it and from the number d of components present, so a reading that is
    partly missing is judged by what is there.

    A gate trusts the belief more than the reading. When the belief is what is wrong, every
    good reading is refused for ever; with ``recovery`` seconds given, after that time of
    nothing but refusals the gate lets a reading in as :func:`regain` does.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 5.7.2.
    """

    false_alarm: float = eqx.field(static=True, default=0.01)
    recovery: float | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if not 0 < self.false_alarm < 1:
            raise ContractError(
                f"gate: false_alarm is {self.false_alarm:g}, must be between 0 and 1; it is "
                "the probability of refusing a good reading, e.g. 0.01"
            )
        if self.recovery is not None and not 0 < self.recovery < np.inf:
            raise ContractError(
                f"gate: recovery is {self.recovery:g} s, must be above 0 and finite, e.g. 5"
            )

    def unwrap(self, belief: Any) -> Any:
        """Without the time of refusals."""
        return belief if self.recovery is None else belief.belief

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """The inner filter's belief; with ``recovery``, watched."""
        inner = self.inner.init(prior, key)
        if self.recovery is None:
            return inner
        return Watched(inner, jnp.asarray(-1.0))

    def predict(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> Any:
        """The inner filter's prediction."""
        if self.recovery is None:
            return self.inner.predict(vehicle, belief, control, dt, key)
        moved = self.inner.predict(vehicle, belief.belief, control, dt, key)
        refused_for = belief.refused_for
        return Watched(moved, jnp.where(refused_for < 0, refused_for, refused_for + dt))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """The inner filter's update, undone if the reading falls outside the gate."""
        if self.recovery is None:
            return self._judged(model, belief, measurement, key)
        posterior, score = self._judged(model, belief.belief, measurement, key)
        lost = belief.refused_for >= self.recovery
        posterior, score = regain(
            self.inner, model, belief.belief, measurement, key, lost, (posterior, score)
        )
        refused_for = jnp.maximum(belief.refused_for, 0.0)
        return Watched(posterior, jnp.where(score.accepted, -1.0, refused_for)), score

    def _judged(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        posterior, score = self.inner.update(model, belief, measurement, key)
        bound = bound_of(score, self.false_alarm)
        # What the inner filter has left out already keeps the inner filter's reason.
        taken = jnp.asarray(score.accepted)
        own = jnp.minimum(bound, score.threshold)
        threshold = jnp.where(taken, own, score.threshold)
        inside = score.nis <= threshold
        kept = jax.tree.map(lambda new, old: jnp.where(inside, new, old), posterior, belief)
        return kept, score._replace(accepted=taken & inside, threshold=threshold)


def bound_of(score: Innovation, false_alarm: float) -> Float[Array, ""]:
    r"""$\chi^2_d(1 - \alpha)$ for the d components that are present; infinite without any."""
    sizes = np.arange(score.residual.shape[0] + 1)
    bounds = np.where(sizes > 0, chdtri(np.maximum(sizes, 1), false_alarm), np.inf)
    return jnp.asarray(bounds)[score.dof]


def regain(
    filter: AbstractFilter,
    model: AbstractMeasurementModel,
    belief: Any,
    measurement: Any,
    key: PRNGKeyArray,
    lost: Any,
    judged: tuple[Any, Innovation],
) -> tuple[Any, Innovation]:
    r"""Where the belief is ``lost`` and a gate has refused the reading, let it in after all.

    The belief's covariance is multiplied by $\epsilon / d$ first, the ratio of the normalised
    innovation squared to its expectation: what the reading says becomes plausible, so the
    state goes there in one update, and its covariance says how little is known. Slow
    quantities keep theirs: a vehicle that is lost has not changed its wheels or its radios.
    A filter may do more (:meth:`kedge.core.contracts.AbstractFilter.regained`).
    """
    posterior, score = judged
    refused = lost & ~(score.nis <= score.threshold)
    factor = jnp.maximum(score.nis / jnp.maximum(score.dof, 1), 1.0)
    factor = jnp.where(refused & jnp.isfinite(factor), factor, 1.0)
    anew, again = filter.update(model, filter.regained(belief, factor), measurement, key)
    again = again._replace(threshold=jnp.full_like(jnp.asarray(score.threshold), jnp.inf))
    return jax.tree.map(
        lambda new, old: jnp.where(refused, new, old), (anew, again), (posterior, score)
    )
