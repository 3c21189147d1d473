"""Beliefs: what a filter carries between measurements. Each can report its moments."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.manifolds import space

State = Any


class Gaussian(NamedTuple):
    """Normal distribution in the tangent space at ``mean``."""

    mean: State
    cov: Float[Array, "*batch n n"]

    def moments(self) -> "Gaussian":
        """Itself."""
        return self


@runtime_checkable
class Belief(Protocol):
    """Whatever a filter carries; plots, metrics and messages use only its moments."""

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        ...


class Ensemble(NamedTuple):
    """Equally weighted states; every leaf has a leading member axis."""

    members: State

    def moments(self) -> Gaussian:
        """Sample mean, and sample covariance with the unbiased divisor N - 1."""
        count = jax.tree.leaves(self.members)[0].shape[0]
        mean, cov = weighted_moments(self.members, jnp.full((count,), 1 / count))
        return Gaussian(mean, cov * (count / (count - 1)))


class Particles(NamedTuple):
    """Weighted states; ``log_weights`` are normalised."""

    states: State
    log_weights: Float[Array, " N"]

    def moments(self) -> Gaussian:
        """Weighted mean and covariance."""
        return weighted_moments(self.states, jnp.exp(self.log_weights))


def weighted_moments(states: State, weights: Float[Array, " N"]) -> Gaussian:
    r"""Mean and covariance of weighted points on a manifold.

    The mean is the fixed point of $\bar x \leftarrow \bar x \boxplus \sum_i w_i
    (x_i \boxminus \bar x)$; three sweeps from the heaviest point suffice for the spreads that
    a filter produces.
    """
    manifold = space(states)
    first = jnp.argmax(weights)
    mean = jax.tree.map(lambda leaf: leaf[first], states)
    spread = jax.vmap(manifold.boxminus, (0, None))
    for _ in range(3):
        mean = manifold.boxplus(mean, weights @ spread(states, mean))
    deviations = spread(states, mean)
    return Gaussian(mean, deviations.T @ (weights[:, None] * deviations))
