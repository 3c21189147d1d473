"""The record that every update leaves: one function, so that all filters mean the same."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from kedge.core.contracts import Innovation
from kedge.numerics.linalg import cholesky, solve_lower, symmetric


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


def mixture_innovation(
    log_weights: Float[Array, " K"], scores: Innovation, dof: Int[Array, ""] | int
) -> Innovation:
    r"""The innovation by the moments of a mixture's predictions, one for each component.

    $\nu = \sum_k w_k \nu_k$, $S = \sum_k w_k (S_k + (\nu_k - \nu)(\nu_k - \nu)^\top)$.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 1.4.16 (moments of a mixture).
    """
    weights = jnp.exp(log_weights)
    residual = weights @ scores.residual
    spread = scores.residual - residual[None]
    within = jnp.sum(weights[:, None, None] * scores.cov, axis=0)
    S = symmetric(within + spread.T @ (weights[:, None] * spread))
    return innovation(residual, S, cholesky(S), dof)._replace(
        accepted=jnp.all(scores.accepted), repairs=jnp.sum(scores.repairs)
    )
