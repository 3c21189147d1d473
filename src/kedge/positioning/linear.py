"""Linear least squares: differences of squared ranges are linear in the position."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from kedge.positioning.fix import Fix, bound, finished, inverse
from kedge.positioning.geometry import layout, nearer
from kedge.positioning.links import Links, usable

Weighting = Literal["none", "rows", "mean-square", "full"]


class Rows(NamedTuple):
    """The linear system, solved: position = origin + gain @ half_squares."""

    origin: Float[Array, " d"]
    gain: Float[Array, "d m"]
    """Each row sums to zero: a constant in all half squares changes nothing."""
    half_squares: Float[Array, " m"]
    r"""$(\lVert a_i - o \rVert^2 - D_i^2) / 2$."""


def linear(
    links: Links,
    weighting: Weighting = "full",
    debias: bool = True,
    reference: int = 0,
    near: Float[Array, " d"] | None = None,
    printed: bool = False,
) -> Fix:
    r"""Least squares on differences of squared ranges against a reference anchor r.

    $(a_i - a_r)^\top x = \tfrac12 [(\lVert a_i \rVert^2 - D_i^2) - (\lVert a_r \rVert^2 -
    D_r^2)]$ for all $i \ne r$. The rows share the error of the reference: their covariance is
    $\mathrm{diag}(v_i) + v_r 1 1^\top$ with $v_i = D_i^2 \sigma_i^2 + \sigma_i^4 / 2$.

    Args:
        links: the epoch.
        weighting: "none"; "rows" by $1/\sigma_i^2$ or "mean-square" by $1/(\sigma_i^2 +
            \mu_i^2)$, as the source has it; "full" by the inverse of the covariance, which does
            not depend on the reference.
        debias: take the known bias from the ranges, and $\sigma_i^2$ from their squares.
        reference: number of the anchor r, from 0; if it was not heard, the first that was.
        near: of two mirror images, take the one nearer to this; else the lower one.
        printed: square the coordinates as the source's equations 3 and 5 print it, $X^2 - Y^2$,
            which moves the fix by metres.

    Source: J. Qiu, Y. Zhang, M. Tang, P. Ma, J. Ran, "Research on AGV positioning method
    combined with IMU and UWB", Archives of Transport 64(4), 2022, equations 3 to 6 and 10,
    corrected.
    """
    chosen = links if debias else links._replace(bias=jnp.zeros_like(links.bias))
    safe, used = usable(chosen)
    shape = layout(safe.anchors, used)
    length = safe.ranges - safe.bias
    squared = length**2 - safe.rise**2 - (safe.std**2 if debias else 0.0)
    weights = row_weights(links._replace(ranges=safe.ranges), weighting, debias)
    origin, gain = solution(safe.anchors, used, weights, weighting == "full", reference)
    signs = jnp.ones(len(origin))
    if printed:
        origin, signs = jnp.zeros_like(origin), -signs.at[0].set(-1.0)
    squares = jnp.sum(signs[None] * (safe.anchors - origin[None]) ** 2, axis=1)
    estimate = origin + gain @ jnp.where(used, (squares - squared) / 2, 0.0)
    # Rows say nothing across a line or plane of anchors; the lengths themselves say how far.
    along = shape.axes[:, 1:]
    foot = shape.centre + along @ (along.T @ (estimate - shape.centre))
    excess = squared - jnp.sum((foot[None] - safe.anchors) ** 2, axis=1)
    across = jnp.sum(jnp.where(used, excess, 0.0)) / jnp.maximum(jnp.sum(used), 1)
    side = foot + jnp.sqrt(jnp.maximum(across, 0.0)) * shape.axes[:, 0]
    nowhere = jnp.full_like(estimate, jnp.nan)
    position = jnp.where(shape.flat, side, estimate)
    position = nearer(shape, position, nowhere if near is None else near)
    variance = jnp.where(used, half_square_variance(length, safe.std), 0.0)
    cov = jnp.where(shape.flat, bound(chosen, position), (gain * variance[None]) @ gain.T)
    return finished(chosen, shape, position, cov)


def half_square_variance(
    length: Float[Array, " m"], std: Float[Array, " m"]
) -> Float[Array, " m"]:
    r"""Variance of $D^2 / 2$ for $D \sim N(d, \sigma^2)$: $d^2 \sigma^2 + \sigma^4 / 2$."""
    return length**2 * std**2 + std**4 / 2


def row_weights(links: Links, weighting: Weighting, debias: bool) -> Float[Array, " m"]:
    """By anchor: of its row, or with "full" of its own half square."""
    if weighting == "none":
        return jnp.ones_like(links.std)
    if weighting == "rows":
        return 1 / links.std**2
    if weighting == "mean-square":
        return 1 / (links.std**2 + links.bias**2)
    length = links.ranges - links.bias if debias else links.ranges
    return 1 / half_square_variance(length, links.std)


def solution(
    anchors: Float[Array, "m d"],
    used: Bool[Array, " m"],
    weights: Float[Array, " m"],
    full: bool,
    reference: int,
) -> tuple[Float[Array, " d"], Float[Array, "d m"]]:
    """Origin and gain of the weighted rows."""
    weights = jnp.where(used, weights, 0.0)
    weights = weights / jnp.max(weights)
    heard = jnp.where(used[reference], reference, jnp.argmax(used))
    if full:
        # A free constant in every row is the same as differences with their full covariance.
        origin = weights @ anchors / jnp.sum(weights)
    else:
        origin = anchors[heard]
    away = anchors - origin[None]
    lean = away * weights[:, None]
    normal = lean.T @ away
    if not full:
        lean = lean.at[heard].set(-jnp.sum(lean, axis=0))
    # Where anchors are flat nothing is known across them: a little of everything inverts it.
    shape = layout(anchors, used)
    across = shape.axes[:, :1] * jnp.trace(normal)
    normal = normal + jnp.where(shape.flat, across @ shape.axes[:, :1].T, 0.0)
    return origin, inverse(normal) @ lean.T


class Moments(NamedTuple):
    """What a linear solver gives in the mean, and how it scatters."""

    bias: Float[Array, " d"]
    cov: Float[Array, "d d"]

    @property
    def rmse(self) -> Float[Array, ""]:
        """Root of the mean squared error of the position, m."""
        return jnp.sqrt(jnp.sum(self.bias**2) + jnp.trace(self.cov))


def linear_moments(
    links: Links,
    position: Float[Array, " d"],
    weighting: Weighting = "none",
    debias: bool = False,
    reference: int = 0,
) -> Moments:
    r"""Bias and covariance of :func:`linear` at a true position, in closed form.

    For independent $D_i \sim N(d_i + \mu_i, \sigma_i^2)$, with $\mu_i$ and $\sigma_i$ of
    ``links`` (whose ranges are not looked at): $E[D_i^2] = (d_i + \mu_i)^2 + \sigma_i^2$ and
    $\mathrm{Var}[D_i^2 / 2] = (d_i + \mu_i)^2 \sigma_i^2 + \sigma_i^4 / 2$. Exact for weights
    that do not depend on the ranges, as all but "full" are.

    Source: S. M. Kay, "Fundamentals of Statistical Signal Processing: Estimation Theory", 1993,
    chapter 6.
    """
    away = position[None] - links.anchors
    distance = jnp.sqrt(jnp.sum(away**2, axis=1) + links.rise**2)
    mean = distance if debias else distance + links.bias
    used = jnp.ones(len(mean), bool)
    weights = row_weights(links._replace(ranges=distance + links.bias), weighting, debias)
    _, gain = solution(links.anchors, used, weights, weighting == "full", reference)
    excess = mean**2 + (0.0 if debias else links.std**2) - distance**2
    variance = half_square_variance(mean, links.std)
    return Moments(gain @ (-excess / 2), (gain * variance[None]) @ gain.T)
