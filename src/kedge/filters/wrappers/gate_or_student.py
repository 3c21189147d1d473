"""A gate while it refuses little, heavy tails when it refuses much."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractMeasurementModel, AbstractVehicle, Innovation
from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.wrappers.gated import bound_of
from kedge.filters.wrappers.wrapper import AbstractWrapper, Inflated
from kedge.numerics.losses import Loss


class Counted(NamedTuple):
    """The inner filter's belief, and how many readings of late a gate would have refused."""

    belief: Any
    refused: Float[Array, ""]
    all: Float[Array, ""]
    outside_for: Float[Array, ""]
    """s since the first reading outside after the last one inside; -1 if there was none."""

    def moments(self) -> Gaussian:
        """The inner belief's."""
        return self.belief.moments()

    def widened(self, factor: Scalar) -> "Counted":
        """The inner belief widened."""
        return self._replace(belief=self.belief.widened(factor))


@filters.add("gate-or-student")
class GateOrStudent(AbstractWrapper):
    r"""A gate where the prediction can be trusted, a Student-t where it cannot.

    A gate is the better of the two while the belief is right, since an outlier then moves
    nothing at all; it locks out when the belief is wrong. So the share of the readings that
    are outside of it is watched, $\rho = \sum_i o_i e^{-(t - t_i)/T} / \sum_i e^{-(t - t_i)/T}$
    over all readings i before this one, with $o_i = 1$ outside. While $\rho \le$ ``share`` a
    reading outside is refused; above it none is, and R is multiplied by
    $\max(1, (\nu + d^2) / (\nu + m))$ instead.

    Neither moves a belief that is sure and far off. After ``recovery`` seconds of nothing but
    readings outside, the covariance is multiplied by $d^2 / m$ before the next of them, as
    :func:`kedge.filters.wrappers.gated.regain` does: what the reading says is plausible then.

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
    recovery: Scalar = 5.0

    def __check_init__(self):
        for name in ("false_alarm", "share"):
            found = getattr(self, name)
            if not 0 < found < 1:
                raise ContractError(
                    f"gate-or-student: {name} is {found:g}, must be between 0 and 1"
                )
        for name in ("window", "tuning", "recovery"):
            found = getattr(self, name)
            if isinstance(found, int | float) and not 0 < found < np.inf:
                raise ContractError(
                    f"gate-or-student: {name} is {found:g}, must be above 0 and finite"
                )

    def unwrap(self, belief: Any) -> Any:
        """Without the counts."""
        return belief.belief

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Counted:
        """The inner filter's belief; nothing was refused yet."""
        none = jnp.asarray(0.0)
        return Counted(self.inner.init(prior, key), none, none, jnp.asarray(-1.0))

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Counted,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Counted:
        """The inner filter's prediction; what was refused is forgotten by and by."""
        moved = self.inner.predict(vehicle, belief.belief, control, dt, key)
        kept = jnp.exp(-dt / self.window)
        outside_for = belief.outside_for + jnp.where(belief.outside_for < 0, 0.0, dt)
        return Counted(moved, belief.refused * kept, belief.all * kept, outside_for)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Counted,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Counted, Innovation]:
        """The inner filter's update, or none, or one with the noise that the residual asks."""
        _, score = self.inner.update(model, belief.belief, measurement, key)
        own = bound_of(score, self.false_alarm)
        outside = ~(score.nis <= own)
        lost = outside & (belief.outside_for >= self.recovery)
        trusted = ~lost & (belief.refused <= self.share * belief.all)
        tails = Loss("student", self.tuning).factor(score.residual, score.cov, score.dof)
        widening = jnp.maximum(score.nis / jnp.maximum(score.dof, 1), 1.0)
        widening = jnp.where(lost & jnp.isfinite(widening), widening, 1.0)
        eased = Inflated(model, jnp.where(trusted | lost, 1.0, tails))
        anew = self.inner.regained(belief.belief, widening)
        wide = jax.tree.map(lambda new, old: jnp.where(lost, new, old), anew, belief.belief)
        posterior, _ = self.inner.update(eased, wide, measurement, key)
        threshold = jnp.where(trusted, jnp.minimum(own, score.threshold), jnp.inf)
        refused = trusted & outside
        kept = jax.tree.map(
            lambda old, new: jnp.where(refused, old, new), belief.belief, posterior
        )
        since = jnp.where(outside, jnp.maximum(belief.outside_for, 0.0), -1.0)
        outliers = belief.refused + jnp.where(outside, 1.0, 0.0)
        counted = Counted(kept, outliers, belief.all + 1.0, jnp.where(lost, -1.0, since))
        accepted = jnp.asarray(score.accepted) & ~refused
        return counted, score._replace(accepted=accepted, threshold=threshold)
