"""Filtering and smoothing as an associative operation: a log's events in any grouping.

Source: S. Särkkä and Á. García-Fernández, "Temporal parallelization of Bayesian smoothers",
IEEE Trans. Autom. Control 66(1), 2021, sections III and IV.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.numerics.linalg import cholesky, gain, solve_lower, square_root, symmetric


class Affine(NamedTuple):
    r"""One event of a linear model: $e' = F e + u + q$, $q \sim N(0, Q)$."""

    F: Float[Array, "*T n n"]
    u: Float[Array, "*T n"]
    Q: Float[Array, "*T n n"]


class FilterElement(NamedTuple):
    r"""What some events in a row do to a state e before them.

    $p(e' \mid e, z) = N(A e + b, C)$ for the state after them, and what their readings say
    of e is $\propto \exp(\eta^\top e - \tfrac12 e^\top J e)$.
    """

    A: Float[Array, "*T n n"]
    b: Float[Array, "*T n"]
    C: Float[Array, "*T n n"]
    eta: Float[Array, "*T n"]
    J: Float[Array, "*T n n"]


class SmootherElement(NamedTuple):
    """The state given one later: $e = E e' + g + N(0, L)$."""

    E: Float[Array, "*T n n"]
    g: Float[Array, "*T n"]
    L: Float[Array, "*T n n"]


def known(mean: Float[Array, " n"], cov: Float[Array, "n n"]) -> FilterElement:
    """A state that does not depend on what was before it: the prior."""
    none = jnp.zeros_like(cov)
    return FilterElement(none, mean, cov, jnp.zeros_like(mean), none)


def unseen(motion: Affine) -> FilterElement:
    """An event without a reading."""
    none = jnp.zeros_like(motion.Q)
    return FilterElement(motion.F, motion.u, motion.Q, jnp.zeros_like(motion.u), none)


def seen(
    motion: Affine,
    residual: Float[Array, " m"],
    H: Float[Array, "m n"],
    R: Float[Array, "m m"],
) -> FilterElement:
    """An event with a reading: ``residual`` is that of the origin, $r = H e + N(0, R)$."""
    F, u, Q = motion
    root = cholesky(symmetric(H @ Q @ H.T + R))
    K = gain(Q @ H.T, root)
    reduction = jnp.eye(F.shape[0], dtype=F.dtype) - K @ H
    unexplained = residual - H @ u
    # With S = L L', W = L^-1 H F: J = W' W, eta = W' L^-1 (r - H u).
    white = solve_lower(root, H @ F)
    return FilterElement(
        A=reduction @ F,
        b=u + K @ unexplained,
        C=symmetric(reduction @ Q @ reduction.T + K @ R @ K.T),
        eta=white.T @ solve_lower(root, unexplained),
        J=white.T @ white,
    )


def after(early: FilterElement, late: FilterElement) -> FilterElement:
    r"""Both, one after the other.

    $(I + C_1 J_2)^{-1} = I - W^\top W J_2$ with $C_1 = L L^\top$,
    $I + L^\top J_2 L = M M^\top$ and $W = M^{-1} L^\top$: only symmetric matrices are
    factorised, so no pivots have to be searched.
    """
    L = square_root(early.C)
    one = jnp.eye(L.shape[0], dtype=L.dtype)
    W = solve_lower(cholesky(symmetric(one + L.T @ late.J @ L)), L.T)
    updated = W.T @ W
    weighed = one - updated @ late.J
    through = late.A @ weighed
    back = early.A.T @ weighed.T
    return FilterElement(
        A=through @ early.A,
        b=through @ (early.b + early.C @ late.eta) + late.b,
        C=symmetric(late.A @ updated @ late.A.T) + late.C,
        eta=back @ (late.eta - late.J @ early.b) + early.eta,
        J=symmetric(back @ late.J @ early.A) + early.J,
    )


def given_later(
    mean: Float[Array, " n"], cov: Float[Array, "n n"], motion: Affine
) -> SmootherElement:
    """A filtered state in the light of the state after the next event."""
    F, u, Q = motion
    predicted = symmetric(F @ cov @ F.T + Q)
    # Jitter relative to each variance: a state known exactly has a singular one.
    jitter = jnp.diag(1e-12 * jnp.diag(predicted) + jnp.finfo(cov.dtype).tiny)
    E = gain(cov @ F.T, cholesky(predicted + jitter))
    reduction = jnp.eye(F.shape[0], dtype=F.dtype) - E @ F
    return SmootherElement(
        E, mean - E @ (F @ mean + u), symmetric(reduction @ cov @ reduction.T + E @ Q @ E.T)
    )


def final(mean: Float[Array, " n"], cov: Float[Array, "n n"]) -> SmootherElement:
    """The last state, which has nothing later."""
    return SmootherElement(jnp.zeros_like(cov), mean, cov)


def before(late: SmootherElement, early: SmootherElement) -> SmootherElement:
    """Both, in the order in which a scan from the end meets them."""
    return SmootherElement(
        early.E @ late.E,
        early.E @ late.g + early.g,
        symmetric(early.E @ late.L @ early.E.T) + early.L,
    )
