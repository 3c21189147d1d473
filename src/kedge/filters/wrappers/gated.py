"""Gate: a reading too far from the prediction is refused, by any filter."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractMeasurementModel, Innovation
from kedge.core.errors import ContractError
from kedge.core.registry import filters
from kedge.filters.wrappers.wrapper import FALSE_ALARM, AbstractOutlierTest, bound_of


@filters.add("gated")
class Gated(AbstractOutlierTest):
    r"""A gate around the filter ``inner``, set by its false-alarm probability.

    Accepts a reading if $\nu^\top S^{-1} \nu \le \chi^2_d(1 - \alpha)$.

    ``false_alarm`` is $\alpha$, the share of good readings refused if the model is right; the
    bound follows from it and from the number d of components present, so a reading that is
    partly missing is judged by what is there. After ``recovery`` seconds of nothing but
    refusals of a sensor one reading of it is let in; infinity is never.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 5.7.2.
    """

    false_alarm: float = eqx.field(static=True, default=FALSE_ALARM)

    def __check_init__(self):
        if not 0 < self.false_alarm < 1:
            raise ContractError(
                f"gate: false_alarm is {self.false_alarm:g}, must be between 0 and 1; it is "
                "the probability of refusing a good reading, e.g. 0.01"
            )

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """The inner filter's update, undone if the reading falls outside the gate."""
        posterior, score = self.inner.update(model, belief, measurement, key)
        bound = bound_of(score, self.false_alarm)
        # What the inner filter has left out already keeps the inner filter's reason.
        accepted = jnp.asarray(score.accepted)
        threshold = jnp.where(accepted, jnp.minimum(bound, score.threshold), score.threshold)
        inside = score.nis <= threshold
        kept = jax.tree.map(lambda new, old: jnp.where(inside, new, old), posterior, belief)
        return kept, score._replace(
            accepted=accepted & inside, threshold=threshold, outlying=score.outlying | ~inside
        )
