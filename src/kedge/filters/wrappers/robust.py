"""Heavy-tailed noise around any filter: outliers are weighed down instead of cut off."""

from typing import Any

import equinox as eqx
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractMeasurementModel, Innovation
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.wrappers.wrapper import (
    FALSE_ALARM,
    AbstractOutlierTest,
    Inflated,
    bound_of,
)
from kedge.numerics.losses import Loss


@filters.add("robust")
class Robust(AbstractOutlierTest):
    r"""Multiplies R by what the ``loss`` asks for, before the update of the filter ``inner``.

    ``tuning`` is the loss's parameter and ``side`` the sign of the innovations that it weighs:
    see :class:`kedge.numerics.losses.Loss`. One pass, so the update stays straight-line. What
    is reported (NIS, likelihood) is the innovation under the nominal noise, so that gates and
    consistency tests keep their sense.

    A loss that weighs a wrong belief's readings down goes to them slowly or never. A reading
    weighed down outside the gate of :data:`FALSE_ALARM` is an outlier; after ``recovery``
    seconds of nothing but outliers of a sensor one is let in whole; infinity is never.

    Source: M. Roth, E. Özkan, F. Gustafsson, "A Student's t filter for heavy tailed process
    and measurement noise", ICASSP 2013.
    """

    loss: str = eqx.field(static=True, default="student")
    tuning: Scalar | None = None
    side: str = eqx.field(static=True, default="both")

    def __check_init__(self):
        Loss(self.loss, self.tuning, self.side)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """The inner filter's update with the noise that the residual calls for."""
        _, score = self.inner.update(model, belief, measurement, key)
        loss = Loss(self.loss, self.tuning, self.side)
        factor = loss.factor(score.residual, score.cov, score.dof)
        posterior, _ = self.inner.update(Inflated(model, factor), belief, measurement, key)
        outlying = (factor > 1) & (score.nis > bound_of(score, FALSE_ALARM))
        return posterior, score._replace(outlying=score.outlying | outlying)
