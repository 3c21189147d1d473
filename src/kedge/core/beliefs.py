"""Beliefs: what a filter carries between measurements. Each can report its moments."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from kedge.core.manifolds import Chart, Euclidean, augmented_of, space
from kedge.core.rotations import Scalar

State = Any


def stretch(state: State, factor: Scalar) -> Scalar | Float[Array, " n"]:
    r"""By what errors about a state grow where their covariance is multiplied by ``factor``.

    $\sqrt{f}$, but 1 for augmented states: a vehicle that has lost its way still has the wheels
    and radios that it had, and a scale with a spread of ten is soon 0 or below.
    """
    root, augmented = jnp.sqrt(factor), augmented_of(type(state))
    return jnp.where(jnp.array(augmented), 1.0, root) if any(augmented) else root


def inflated_cov(
    state: State, cov: Float[Array, "*batch n n"], factor: Scalar
) -> Float[Array, "*batch n n"]:
    """A covariance of errors that grew by :func:`stretch`; correlations stay."""
    grown = jnp.asarray(stretch(state, factor))
    if grown.ndim == 0:
        return cov * factor
    return cov * jnp.broadcast_to(grown[:, None] * grown[None], cov.shape)


class Gaussian(NamedTuple):
    """Normal distribution in the tangent space at ``mean``."""

    mean: State
    cov: Float[Array, "*batch n n"]

    def moments(self) -> "Gaussian":
        """Itself."""
        return self

    def inflated(self, factor: Scalar) -> "Gaussian":
        """The same mean, the covariance times ``factor`` but for augmented states."""
        return Gaussian(self.mean, inflated_cov(self.mean, self.cov, factor))


@runtime_checkable
class Belief(Protocol):
    """Whatever a filter carries; plots, metrics and messages use only its moments."""

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        ...

    def inflated(self, factor: Scalar) -> Any:
        """The same mean and ``factor`` times the covariance, but for augmented states."""
        ...


class Ensemble(NamedTuple):
    """Equally weighted states.

    They lie side by side, so that the vector units work on many members at once: every leaf
    has its members on the last axis, one component of the state after the other.
    """

    columns: State

    @classmethod
    def of(cls, members: State) -> "Ensemble":
        """From states whose leaves have a leading member axis."""
        shapes = [chart.shape for chart in space(members).charts]
        parts = [
            jnp.moveaxis(leaf, -1 - len(shape), -1)
            for leaf, shape in zip(members, shapes, strict=True)
        ]
        return cls(type(members)(*parts))

    @property
    def members(self) -> State:
        """The states, every leaf with a leading member axis."""
        shapes = [chart.shape for chart in space(self.columns).charts]
        parts = [
            jnp.moveaxis(leaf, -1, -1 - len(shape))
            for leaf, shape in zip(self.columns, shapes, strict=True)
        ]
        return type(self.columns)(*parts)

    def moments(self) -> Gaussian:
        """Sample mean, and sample covariance with the unbiased divisor N - 1."""
        mean, anomalies = self.centred()
        return Gaussian(mean, anomalies @ anomalies.T / (anomalies.shape[1] - 1))

    def centred(self) -> tuple[State, Float[Array, "n N"]]:
        r"""Sample mean, and the anomalies: the tangent vectors from it to the members.

        The mean of each quantity is the fixed point of $\bar x \leftarrow \bar x \boxplus
        \tfrac1N \sum_i (x_i \boxminus \bar x)$; three sweeps from the first member suffice
        for the spreads that a filter produces, and one where the space is flat.
        """
        parts, spreads = [], []
        for chart, column in zip(space(self.columns).charts, self.columns, strict=True):
            mean = column[..., 0]
            for _ in range(1 if isinstance(chart, Euclidean) else 3):
                mean = chart.boxplus(mean, jnp.mean(_minus(chart, column, mean), axis=-1))
            parts.append(mean)
            spreads.append(_minus(chart, column, mean))
        return type(self.columns)(*parts), jnp.concatenate(spreads)

    def inflated(self, factor: Scalar) -> "Ensemble":
        """The anomalies multiplied as :func:`stretch` says."""
        mean, anomalies = self.centred()
        grown = jnp.broadcast_to(stretch(mean, factor), anomalies.shape[:1])
        return Ensemble.around(mean, grown[:, None] * anomalies)

    @classmethod
    def around(cls, mean: State, anomalies: Float[Array, "n N"]) -> "Ensemble":
        """Members at these tangent vectors from ``mean``."""
        states, parts = space(mean), []
        cuts = states.slices().values()
        for chart, point, cut in zip(states.charts, mean, cuts, strict=True):
            parts.append(_plus(chart, jnp.asarray(point), anomalies[cut]))
        return cls(type(mean)(*parts))


def _minus(chart: Chart, column: Array, base: Array) -> Float[Array, "n N"]:
    """Tangent vectors from ``base`` to members; where it is flat without a call for each."""
    if isinstance(chart, Euclidean):
        return (column - base[..., None]).reshape(chart.size, column.shape[-1])
    return members_wise(chart.boxminus, shared=1)(column, base)


def _plus(chart: Chart, base: Array, deltas: Float[Array, "n N"]) -> Array:
    if isinstance(chart, Euclidean):
        return base[..., None] + deltas.reshape(*chart.shape, deltas.shape[-1])
    return jax.vmap(chart.boxplus, (None, -1), -1)(base, deltas)


def members_wise(function: Callable[..., Any], shared: int = 0) -> Callable[..., Any]:
    """``function`` for each member of columns; the last ``shared`` arguments are the same."""

    def call(*arguments: Any) -> Any:
        members = len(arguments) - shared
        return jax.vmap(function, (-1,) * members + (None,) * shared, -1)(*arguments)

    return call


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

    def inflated(self, factor: Scalar) -> "Particles":
        """The distances from the mean multiplied as :func:`stretch` says."""
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

    def inflated(self, factor: Scalar) -> "Mixture":
        """Every component widened."""
        return self._replace(components=self.components.inflated(factor))


def _stretched(states: State, mean: State, factor: Scalar) -> State:
    manifold, grown = space(states), stretch(mean, factor)
    return jax.vmap(
        lambda state: manifold.boxplus(mean, grown * manifold.boxminus(state, mean))
    )(states)


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
