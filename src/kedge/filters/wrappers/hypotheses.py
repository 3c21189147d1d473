"""A start that is not known: one filter for each of several headings, weighed by readings."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian, Mixture
from kedge.core.contracts import (
    AbstractFilter,
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import Circle, Rotation, charts_of, space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.core.rotations import multiply
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.numerics.innovation import mixture_innovation

TAILS = 4.0  # degrees of freedom of the Student-t that weighs: one outlier decides nothing
HELD = -30.0  # log weight below which no hypothesis falls, so that a change of mind is possible


@filters.add("hypotheses")
class Hypotheses(AbstractFilter[Mixture]):
    r"""A bank of ``count`` filters ``inner`` that start at headings all around the circle.

    Hypothesis k starts at $\psi_0 + 2\pi k / K$ with a spread that fills the gap to its
    neighbours, and $w_k \propto w_k\, t_\nu(z \mid k)$ at each reading. The likelihood has
    heavy tails, so that a single outlier does not decide. What is believed is the mixture: its
    covariance is wide for as long as the readings cannot tell.

    What turns is the state's ``heading`` or, without one, its ``attitude`` about the map's
    vertical axis, for a vehicle that starts about level. The prior's variance of it is not
    looked at. With neither there is one start, and all hypotheses are the same. A gate that
    gives up its belief (``recovery``) starts the bank anew, where it believed to be, widened.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 11.6.2 (static multiple models); M. Roth, E. Özkan,
    F. Gustafsson, "A Student's t filter for heavy tailed process and measurement noise",
    ICASSP 2013.
    """

    inner: AbstractFilter = ExtendedKalman()
    count: int = eqx.field(static=True, default=8)

    def __check_init__(self):
        if not isinstance(self.inner, AbstractGaussianFilter):
            raise ContractError(
                f"hypotheses: inner is {type(self.inner).__name__}, which carries no "
                "Gaussian; expected a filter such as 'extended' or 'unscented'"
            )
        if self.count < 2:
            raise ContractError(f"hypotheses: count is {self.count}, must be at least 2")

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Mixture:
        """Turned copies of the prior, all equally likely."""
        del key
        weights = jnp.full(self.count, -jnp.log(self.count))
        field = _turning(prior.mean)
        if field is None:
            copies = jax.tree.map(
                lambda leaf: jnp.stack([jnp.asarray(leaf)] * self.count), prior
            )
            return Mixture(copies, weights)
        place = space(prior.mean).slices()[field].stop - 1
        gap = 2 * jnp.pi / self.count
        # Neighbours meet at one and a half standard deviations.
        cov = prior.cov.at[place, :].set(0.0).at[:, place].set(0.0)
        cov = cov.at[place, place].set((gap / 3) ** 2)

        def turned(angle: Float[Array, ""]) -> Gaussian:
            return Gaussian(_turn(prior.mean, field, angle), cov)

        components = jax.vmap(turned)(gap * jnp.arange(self.count))
        return Mixture(components, weights)

    def considers(self) -> bool:
        """The inner filter's."""
        return self.inner.considers()

    def reset(self, belief: Mixture, factor: Scalar) -> Mixture:
        """All around the circle again, from the widened moments.

        The hypotheses have become one on the way, and who is lost may face anywhere.
        """
        return self.init(belief.moments().inflated(factor), jr.key(0))

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Mixture,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Mixture:
        """Every hypothesis moves on its own."""

        def one(component: Gaussian) -> Gaussian:
            start = self.inner.init(component, key)
            return self.inner.predict(vehicle, start, control, dt, key).moments()

        return belief._replace(components=jax.vmap(one)(belief.components))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Mixture,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Mixture, Innovation]:
        """Update every hypothesis; weigh it by how well it foresaw the measurement."""

        def one(component: Gaussian) -> tuple[Gaussian, Innovation, Float[Array, ""]]:
            start = self.inner.init(component, key)
            posterior, score = self.inner.update(model, start, measurement, key)
            # The Gaussian's density without its exponent, times the tails' own.
            level = score.log_likelihood + score.nis / 2
            tail = -(TAILS + model.dof()) / 2 * jnp.log1p(score.nis / TAILS)
            return posterior.moments(), score, level + tail

        posteriors, scores, likelihoods = jax.vmap(one)(belief.components)
        joint = belief.log_weights + likelihoods
        weights = jnp.maximum(joint - logsumexp(joint), HELD)

        score = mixture_innovation(belief.log_weights, scores, model.dof())
        evidence = logsumexp(belief.log_weights + scores.log_likelihood)
        mixture = Mixture(posteriors, weights - logsumexp(weights))
        return mixture, score._replace(log_likelihood=evidence)


def _turning(state: Any) -> str | None:
    """Name of the field that has a heading, if there is one."""
    charts = charts_of(type(state))
    kinds = {"heading": Circle, "attitude": Rotation}
    return next(
        (name for name, kind in kinds.items() if isinstance(charts.get(name), kind)), None
    )


def _turn(state: Any, field: str, angle: Float[Array, ""]) -> Any:
    """The state turned about the map's vertical axis; where it is does not change."""
    value = getattr(state, field)
    if field == "heading":
        return state._replace(heading=Circle().boxplus(value, angle[None]))
    half, none = angle / 2, jnp.zeros_like(angle)
    about = jnp.stack([jnp.cos(half), none, none, jnp.sin(half)])
    return state._replace(attitude=multiply(about, jnp.asarray(value)))
