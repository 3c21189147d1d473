"""The record that every update leaves: one function, so that all filters mean the same."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from kedge.core.contracts import Innovation
from kedge.numerics.linalg import solve_lower


def innovation(
    residual: Float[Array, " m"],
    cov: Float[Array, "m m"],
    root: Float[Array, "m m"],
    dof: Int[Array, ""] | int,
) -> Innovation:
    r"""Score a residual $\nu$ against its covariance $S = L L^\top$.

    $\epsilon = \lVert L^{-1}\nu \rVert^2$ and
    $\log p = -\tfrac12(\epsilon + \log\det S + d \log 2\pi)$ with $d$ components present.
    A missing component has residual 0 and unit variance, so it adds nothing to either.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 5.4.
    """
    white = solve_lower(root, residual)
    nis = white @ white
    log_det = 2 * jnp.sum(jnp.log(jnp.diag(root)))
    log_likelihood = -0.5 * (nis + log_det + dof * jnp.log(2 * jnp.pi))
    return Innovation(residual, cov, nis, jnp.asarray(dof), log_likelihood)
