"""Gaussian kernels on clouds of particles: a cloud as a smooth density."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.numerics.linalg import square_root
from kedge.numerics.random import normals


def bandwidth(size: int, count: int) -> float:
    r"""$h = \left(\tfrac{4}{n + 2}\right)^{1 / (n + 4)} N^{-1 / (n + 4)}$ for N points in n.

    The kernel's standard deviation, in those of the cloud, that is best in the mean squared
    error if the density is Gaussian.

    Source: B. Silverman, "Density Estimation for Statistics and Data Analysis", 1986, section
    4.3.2; C. Musso, N. Oudjane, F. Le Gland, "Improving regularised particle filters", in
    "Sequential Monte Carlo Methods in Practice", 2001, section 12.2.
    """
    return (4 / (size + 2) / count) ** (1 / (size + 4))


def roughened(key: PRNGKeyArray, states: Any, cloud: Gaussian, width: Scalar) -> Any:
    r"""Draw each state from its kernel: $x_i \boxplus h L \xi_i$ with $L L^\top = P$.

    The covariance P of the ``cloud`` grows to $(1 + h^2) P$.
    """
    manifold = space(states)
    count = jax.tree.leaves(states)[0].shape[0]
    white = normals(key, (count, manifold.size), cloud.cov.dtype)
    return jax.vmap(manifold.boxplus)(states, width * white @ square_root(cloud.cov).T)


def shrunk(states: Any, cloud: Gaussian, width: Scalar) -> Any:
    r"""Draw each state to the mean: $\bar x \boxplus \sqrt{1 - h^2} (x_i \boxminus \bar x)$.

    Smeared after that, the cloud keeps its mean and covariance. That suits one hump; several
    would move towards each other.

    Source: M. West, "Approximating posterior distributions by mixture", J. R. Stat. Soc. B
    55(2), 1993.
    """
    manifold = space(states)

    def draw_in(state: Any) -> Any:
        error = manifold.boxminus(state, cloud.mean)
        return manifold.boxplus(cloud.mean, jnp.sqrt(1 - jnp.minimum(width, 1.0) ** 2) * error)

    return jax.vmap(draw_in)(states)
