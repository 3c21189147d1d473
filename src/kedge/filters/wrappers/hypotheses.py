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
ANYWHERE = 10.0
"""rad; a heading with this standard deviation is uniform on the circle."""
WIDE = 4.0  # rad^2
HELD = -30.0  # log weight below which no hypothesis falls, so that a change of mind is possible


@filters.add("hypotheses")
class Hypotheses(AbstractFilter[Mixture]):
    r"""A bank of ``count`` filters ``inner`` that start at headings all around the circle.

    Hypothesis k starts at $\psi_0 + 2\pi k / K$ with a spread that fills the gap to its
    neighbours, and $w_k \propto w_k\, t_\nu(z \mid k)$ at each reading. The likelihood has
    heavy tails, so that a single outlier does not decide. What is believed is the mixture: its
    covariance is wide for as long as the readings cannot tell.

    What turns is the state's ``heading`` or, without one, its ``attitude`` about the map's
    vertical axis, for a vehicle that starts about level. At first $w_k = (1 - d)\, p_k + d / K$
    with the prior's density $p_k$ at the k-th heading and the probability d, ``doubt``, that
    the prior is wrong: what is believed faces where the prior does, and a gate still lets in
    what speaks for another heading. With ``doubt=0`` the prior is kept as it is, and one that
    is sure and wrong takes a gate's recovery, or minutes, to be overcome. Without a heading
    there is one start, and all hypotheses are the same. A gate that gives up its belief
    (``recovery``) starts the bank anew, where it believed to be, widened and facing anywhere.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 11.6.2 (static multiple models); M. Roth, E. Özkan,
    F. Gustafsson, "A Student's t filter for heavy tailed process and measurement noise",
    ICASSP 2013.
    """

    inner: AbstractFilter = ExtendedKalman()
    count: int = eqx.field(static=True, default=8)
    doubt: Scalar = 0.1

    def __check_init__(self):
        if not isinstance(self.inner, AbstractGaussianFilter):
            raise ContractError(
                f"hypotheses: inner is {type(self.inner).__name__}, which carries no "
                "Gaussian; expected a filter such as 'extended' or 'unscented'"
            )
        if self.count < 2:
            raise ContractError(f"hypotheses: count is {self.count}, must be at least 2")
        if isinstance(self.doubt, int | float) and not 0 <= self.doubt <= 1:
            raise ContractError(f"hypotheses: doubt is {self.doubt}, must be from 0 to 1")

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Mixture:
        """Turned copies of the prior, each as likely as the prior has it."""
        del key
        field = _turning(prior.mean)
        if field is None:
            copies = jax.tree.map(
                lambda leaf: jnp.stack([jnp.asarray(leaf)] * self.count), prior
            )
            return Mixture(copies, jnp.full(self.count, -jnp.log(self.count)))
        place = space(prior.mean).slices()[field].stop - 1
        variance, gap = prior.cov[place, place], 2 * jnp.pi / self.count
        # Neighbours meet at one and a half standard deviations.
        widest = (gap / 3) ** 2
        alone = prior.cov.at[place, :].set(0.0).at[:, place].set(0.0)
        alone = alone.at[place, place].set(widest)
        known = jnp.where(variance > widest, alone, prior.cov)

        def turned(angle: Float[Array, ""]) -> Gaussian:
            cov = jnp.where(angle == 0, known, alone)
            return Gaussian(_turn(prior.mean, field, angle), cov)

        angles = gap * jnp.arange(self.count)
        density = jnp.exp(_normalised(_around_the_circle(angles, variance)))
        weights = jnp.log((1 - self.doubt) * density + self.doubt / self.count)
        return Mixture(jax.vmap(turned)(angles), _normalised(jnp.maximum(weights, HELD)))

    def considers(self) -> bool:
        """The inner filter's."""
        return self.inner.considers()

    def reset(self, belief: Mixture, factor: Scalar) -> Mixture:
        """All around the circle again, from the widened moments.

        The hypotheses have become one on the way, and who is lost may face anywhere.
        """
        wide = belief.moments().inflated(factor)
        field = _turning(wide.mean)
        if field is not None:
            place = space(wide.mean).slices()[field].stop - 1
            cov = wide.cov.at[place, :].set(0.0).at[:, place].set(0.0)
            wide = wide._replace(cov=cov.at[place, place].set(ANYWHERE**2))
        return self.init(wide, jr.key(0))

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
        weights = _normalised(jnp.maximum(_normalised(joint), HELD))

        score = mixture_innovation(belief.log_weights, scores, model.dof())
        evidence = logsumexp(belief.log_weights + scores.log_likelihood)
        mixture = Mixture(posteriors, weights)
        return mixture, score._replace(log_likelihood=evidence)


def _normalised(log_weights: Float[Array, " K"]) -> Float[Array, " K"]:
    return log_weights - logsumexp(log_weights)


def _around_the_circle(
    angles: Float[Array, " K"], variance: Float[Array, ""]
) -> Float[Array, " K"]:
    """Logarithm of the normal density wrapped around the circle, but for a constant.

    As a sum over laps where it is narrow, as a Fourier series where it is wide.

    Source: K. Mardia, P. Jupp, "Directional Statistics", 2000, section 3.5.7.
    """
    variance = jnp.maximum(variance, 1e-6)  # of no variance at all the first has the weight
    laps = angles[:, None] + 2 * jnp.pi * jnp.arange(-2, 2)[None, :]
    narrow = logsumexp(-(laps**2) / (2 * variance), axis=1)
    order = jnp.arange(1, 4)
    waves = jnp.cos(jnp.outer(angles, order)) @ jnp.exp(-(order**2) * variance / 2)
    wide = jnp.log1p(2 * waves)
    return jnp.where(variance > WIDE, wide, narrow)


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
