"""Beliefs: what a filter carries between measurements. Each can report its moments."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from kedge.core.manifolds import Euclidean, space
from kedge.core.rotations import Scalar

State = Any


class Gaussian(NamedTuple):
    """Normal distribution in the tangent space at ``mean``."""

    mean: State
    cov: Float[Array, "*batch n n"]

    def moments(self) -> "Gaussian":
        """Itself."""
        return self

    def widened(self, factor: Scalar) -> "Gaussian":
        """The same mean, the covariance multiplied by ``factor``."""
        return Gaussian(self.mean, self.cov * factor)


@runtime_checkable
class Belief(Protocol):
    """Whatever a filter carries; plots, metrics and messages use only its moments."""

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        ...

    def widened(self, factor: Scalar) -> Any:
        """A belief like this one with the same mean and ``factor`` times the covariance."""
        ...


class Ensemble(NamedTuple):
    """Equally weighted states; every leaf has a leading member axis."""

    members: State

    def moments(self) -> Gaussian:
        """Sample mean, and sample covariance with the unbiased divisor N - 1."""
        mean, anomalies = self.centred()
        return Gaussian(mean, anomalies.T @ anomalies / (anomalies.shape[0] - 1))

    def centred(self) -> tuple[State, Float[Array, "N n"]]:
        """Sample mean, and the anomalies: the tangent vectors from it to the members."""
        leaf = jax.tree.leaves(self.members)[0]
        count = leaf.shape[0]
        return centred(self.members, jnp.full((count,), 1 / count, leaf.dtype))

    def widened(self, factor: Scalar) -> "Ensemble":
        """The anomalies multiplied by the root of ``factor``."""
        return Ensemble(_stretched(self.members, self.moments().mean, factor))


class LastStep(NamedTuple):
    """The step that led to a cloud, kept so that a reading can have it drawn again."""

    before: State
    """The cloud before the step; every leaf has a leading particle axis."""
    vehicle: Any
    control: Any
    dt: Float[Array, ""]
    """Its length in s; 0 once a reading has been used, for then there is nothing to redraw."""

    def used(self) -> "LastStep":
        """Not to be drawn again."""
        return self._replace(dt=jnp.zeros_like(self.dt))


class Particles(NamedTuple):
    """Weighted states; ``log_weights`` are normalised."""

    states: State
    log_weights: Float[Array, " N"]
    last: LastStep | None = None
    """For filters whose proposal looks at the reading; None before the first prediction."""
    waiting: Bool[Array, ""] | None = None
    """Whether the first reading is still to come; None for filters that do not ask."""

    def moments(self) -> Gaussian:
        """Weighted mean and covariance."""
        return weighted_moments(self.states, jnp.exp(self.log_weights))

    def widened(self, factor: Scalar) -> "Particles":
        """The distances from the mean multiplied by the root of ``factor``."""
        states = _stretched(self.states, self.moments().mean, factor)
        return self._replace(states=states, last=self.last and self.last.used())


class Mixture(NamedTuple):
    """Weighted Gaussians; every leaf has a leading axis of components."""

    components: Gaussian
    log_weights: Float[Array, " M"]
    """Normalised."""

    def moments(self) -> Gaussian:
        """Mean, and covariance within and between the components."""
        return self.merged(jnp.exp(self.log_weights))

    def merged(self, weights: Float[Array, " M"]) -> Gaussian:
        """The Gaussian with the moments of the components under other weights."""
        mean, between = weighted_moments(self.components.mean, weights)
        within = jnp.sum(weights[:, None, None] * self.components.cov, axis=0)
        return Gaussian(mean, within + between)

    def widened(self, factor: Scalar) -> "Mixture":
        """Every component widened."""
        return self._replace(components=self.components.widened(factor))


def _stretched(states: State, mean: State, factor: Scalar) -> State:
    manifold = space(states)

    def stretch(state):
        return manifold.boxplus(mean, jnp.sqrt(factor) * manifold.boxminus(state, mean))

    return jax.vmap(stretch)(states)


def weighted_moments(states: State, weights: Float[Array, " N"]) -> Gaussian:
    """Mean and covariance of weighted points on a manifold."""
    mean, deviations = centred(states, weights)
    return Gaussian(mean, deviations.T @ (weights[:, None] * deviations))


def centred(states: State, weights: Float[Array, " N"]) -> tuple[State, Float[Array, "N n"]]:
    r"""Mean of weighted points on a manifold, and the tangent vectors from it to them.

    The mean is the fixed point of $\bar x \leftarrow \bar x \boxplus \sum_i w_i
    (x_i \boxminus \bar x)$; three sweeps from the heaviest point suffice for the spreads that
    a filter produces, and one where the space is flat.
    """
    manifold = space(states)
    first = jnp.argmax(weights)
    mean = jax.tree.map(lambda leaf: leaf[first], states)
    spread = jax.vmap(manifold.boxminus, (0, None))
    flat = all(isinstance(chart, Euclidean) for chart in manifold.charts)
    for _ in range(1 if flat else 3):
        mean = manifold.boxplus(mean, weights @ spread(states, mean))
    return mean, spread(states, mean)
