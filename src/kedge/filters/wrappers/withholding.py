"""A filter that judges the readings of some sensors, and learns nothing from them."""

from typing import Any

import equinox as eqx
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractMeasurementModel, Innovation
from kedge.filters.wrappers.wrapper import AbstractWrapper


class Withholding(AbstractWrapper):
    """Withholds from the filter ``inner`` what the sensors of these names read.

    The innovation is that of the inner filter, so that a reading is compared with what was
    predicted; the belief stays as it was.
    """

    withheld: tuple[str, ...] = eqx.field(static=True, kw_only=True, default=())

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """The inner filter's, undone where it is withheld."""
        posterior, score = self.inner.update(model, belief, measurement, key)
        return (belief if model.source() in self.withheld else posterior), score
