"""A gate while it refuses little, heavy tails when it refuses much."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

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
from kedge.filters.wrappers.wrapper import (
    AbstractOutlierTest,
    AbstractWrapper,
    Inflated,
    bound_of,
)
from kedge.numerics.losses import Loss


class GateBelief(NamedTuple):
    """The inner filter's belief, and how many readings of late a gate would have refused."""

    belief: Any
    refused: Float[Array, ""]
    all: Float[Array, ""]

    def moments(self) -> Gaussian:
        """The inner belief's."""
        return self.belief.moments()

    def inflated(self, factor: Scalar) -> "GateBelief":
        """The inner belief widened."""
        return self._replace(belief=self.belief.inflated(factor))


@filters.add("gate-or-student")
class GateOrStudent(AbstractOutlierTest):
    r"""A gate where the prediction can be trusted, a Student-t where it cannot.

    A gate is the better of the two while the belief is right, since an outlier then moves
    nothing at all; it locks out when the belief is wrong. So the share of the readings that
    are outside of it is watched, $\rho = \sum_i o_i e^{-(t - t_i)/T} / \sum_i e^{-(t - t_i)/T}$
    over all readings i before this one, with $o_i = 1$ outside. While $\rho \le$ ``share`` a
    reading outside is refused; above it none is, and R is multiplied by
    $\max(1, (\nu + d^2) / (\nu + m))$ instead.

    Neither moves a belief that is sure and far off. After ``recovery`` seconds of nothing but
    readings outside of a sensor one is let in whole; infinity is never.

    ``false_alarm`` is the gate's, ``window`` is T, ``tuning`` $\nu$. What is reported is the
    innovation under the nominal noise.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 5.7.2 (gate); M. Roth, E. Özkan, F. Gustafsson, "A Student's
    t filter for heavy tailed process and measurement noise", ICASSP 2013. The switch between
    them is kedge's.
    """

    false_alarm: float = eqx.field(static=True, default=0.01)
    share: float = eqx.field(static=True, default=0.3)
    window: Scalar = 2.0
    tuning: Scalar = 4.0
    recovery: float = eqx.field(static=True, kw_only=True, default=5.0)

    def __check_init__(self):
        for name in ("false_alarm", "share"):
            value = getattr(self, name)
            if not 0 < value < 1:
                raise ContractError(
                    f"gate-or-student: {name} is {value:g}, must be between 0 and 1"
                )
        for name in ("window", "tuning"):
            value = getattr(self, name)
            if isinstance(value, int | float) and not 0 < value < np.inf:
                raise ContractError(
                    f"gate-or-student: {name} is {value:g}, must be above 0 and finite"
                )

    def unwrap(self, belief: Any) -> Any:
        """Without the counts."""
        return belief.belief

    def trusting(self) -> AbstractFilter:
        """The inner filter's, which leaves the counts as they are."""
        return _Counting(self.inner.trusting())

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> GateBelief:
        """The inner filter's belief; nothing was refused yet."""
        none = jnp.asarray(0.0)
        return GateBelief(self.inner.init(prior, key), none, none)

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: GateBelief,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> GateBelief:
        """The inner filter's prediction; what was refused is forgotten by and by."""
        predicted = self.inner.predict(vehicle, belief.belief, control, dt, key)
        kept = jnp.exp(-dt / self.window)
        return GateBelief(predicted, belief.refused * kept, belief.all * kept)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: GateBelief,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[GateBelief, Innovation]:
        """The inner filter's update, or none, or one with the noise that the residual asks."""
        _, score = self.inner.update(model, belief.belief, measurement, key)
        bound = bound_of(score, self.false_alarm)
        outside = ~(score.nis <= bound)
        trusted = belief.refused <= self.share * belief.all
        tails = Loss("student", self.tuning).factor(score.residual, score.cov, score.dof)
        eased = Inflated(model, jnp.where(trusted, 1.0, tails))
        posterior, _ = self.inner.update(eased, belief.belief, measurement, key)
        threshold = jnp.where(trusted, jnp.minimum(bound, score.threshold), jnp.inf)
        refused = trusted & outside
        kept = jax.tree.map(
            lambda old, new: jnp.where(refused, old, new), belief.belief, posterior
        )
        outliers = belief.refused + jnp.where(outside, 1.0, 0.0)
        counted = GateBelief(kept, outliers, belief.all + 1.0)
        accepted = jnp.asarray(score.accepted) & ~refused
        outlying = score.outlying | outside
        return counted, score._replace(
            accepted=accepted, threshold=threshold, outlying=outlying
        )


class _Counting(AbstractWrapper):
    """The inner filter's updates on a belief with counts."""

    def update(
        self, model: AbstractMeasurementModel, belief: Any, measurement: Any, key: PRNGKeyArray
    ) -> tuple[Any, Innovation]:
        posterior, score = self.inner.update(model, belief.belief, measurement, key)
        return belief._replace(belief=posterior), score
