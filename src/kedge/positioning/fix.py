"""A fix: a position with all that one has to know to trust it."""

import enum
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from kedge.numerics.linalg import cholesky, solve_lower
from kedge.positioning.geometry import Layout, mirrored
from kedge.positioning.links import Links, directions, residuals, usable, use_of

GAP = 9.21
"""A mirror image is not ruled out unless the squares of its residuals are larger by this: by
99 % of chi-square with 2 degrees of freedom."""


class Status(enum.IntEnum):
    """What became of an epoch."""

    FIX = 0
    AMBIGUOUS = 1
    """There is a second position, ``mirror``, that the ranges do not rule out."""
    TOO_FEW = 2
    """Fewer usable ranges than unknowns."""
    NO_FIX = 3
    """The numbers led nowhere."""


class Fix(NamedTuple):
    """Where, how sure, and what speaks against it; NaN where there is no fix."""

    position: Float[Array, "*n d"]
    cov: Float[Array, "*n d d"]
    """Of this solver, under the errors that the epoch states."""
    crlb: Float[Array, "*n"]
    """Root of the trace of the least covariance that any unbiased solver can have, m."""
    pdop: Float[Array, "*n"]
    hdop: Float[Array, "*n"]
    vdop: Float[Array, "*n"]
    """NaN in two dimensions."""
    redundancy: Int[Array, "*n"]
    """Usable ranges less unknowns."""
    residual: Float[Array, "*n m"]
    """Measured less expected by anchor, m; NaN where nothing was used."""
    use: Int[Array, "*n m"]
    """By anchor: see :class:`kedge.positioning.links.Use`."""
    ambiguous: Bool[Array, "*n"]
    mirror: Float[Array, "*n d"]
    """The other position, if it is ambiguous."""
    status: Int[Array, "*n"]


def information(links: Links, position: Float[Array, " d"], used: Bool[Array, " m"]) -> Array:
    r"""Fisher's information $J = \sum_i u_i u_i^\top / \sigma_i^2$ at a position.

    Source: S. M. Kay, "Fundamentals of Statistical Signal Processing: Estimation Theory",
    1993, section 3.9.
    """
    rows = directions(links, position) * (used / links.std)[:, None]
    return rows.T @ rows


def inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Of a positive definite matrix; NaN where it is not."""
    size = matrix.shape[0]
    root = solve_lower(cholesky(matrix), jnp.eye(size, dtype=matrix.dtype))
    return root.T @ root


def bound(links: Links, position: Float[Array, " d"]) -> Float[Array, "d d"]:
    """The Cramér-Rao bound on the covariance of a position."""
    safe, used = usable(links)
    return inverse(information(safe, position, used))


def finished(
    links: Links,
    layout: Layout,
    position: Float[Array, " d"],
    cov: Float[Array, "d d"],
    unknowns: int | None = None,
) -> Fix:
    """Judge a solver's position."""
    safe, used = usable(links)
    size = links.anchors.shape[1]
    count = jnp.sum(used)
    needed = size if unknowns is None else unknowns
    other = mirrored(layout, position)
    errors = [jnp.where(used, residuals(safe, p) / links.std, 0.0) for p in (position, other)]
    gap = jnp.sum(errors[1] ** 2) - jnp.sum(errors[0] ** 2)
    apart = jnp.sum((other - position) ** 2)
    exact = inverse(information(safe, position, used))
    spread = jnp.trace(exact)
    # A mirror image within the uncertainty of the fix is no second position.
    ambiguous = layout.flat | ((gap < GAP) & (apart > 9 * spread))
    dop = inverse(information(safe._replace(std=jnp.ones_like(safe.std)), position, used))
    vertical = jnp.sqrt(dop[2, 2]) if size == 3 else jnp.asarray(jnp.nan)
    status = jnp.where(ambiguous, Status.AMBIGUOUS, Status.FIX)
    finite = jnp.isfinite(position).all() & jnp.isfinite(cov).all()
    status = jnp.where(finite, status, Status.NO_FIX)
    status = jnp.where(count < needed, Status.TOO_FEW, status)
    solved = status <= Status.AMBIGUOUS

    def known(value: Array) -> Array:
        return jnp.where(solved, value, jnp.nan)

    return Fix(
        position=known(position),
        cov=known(cov),
        crlb=known(jnp.sqrt(spread)),
        pdop=known(jnp.sqrt(jnp.trace(dop))),
        hdop=known(jnp.sqrt(dop[0, 0] + dop[1, 1])),
        vdop=known(vertical),
        redundancy=count - needed,
        residual=jnp.where(used & solved, residuals(safe, position), jnp.nan),
        use=use_of(links),
        ambiguous=ambiguous & solved,
        mirror=jnp.where(ambiguous & solved, other, jnp.nan),
        status=status,
    )
