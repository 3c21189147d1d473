"""Differences of ranges: anchors that share a clock hear a tag that does not."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from kedge.positioning.fix import Fix, finished, inverse
from kedge.positioning.geometry import layout, nearer
from kedge.positioning.links import Links, directions, distances
from kedge.positioning.nonlinear import descend

GRID = 7
"""Starts along each axis; the likelihood has several maxima outside the anchors."""


def differences(links: Links, near: Float[Array, " d"] | None = None) -> Fix:
    r"""The most likely position from pseudo-ranges $D_i = \lVert x - a_i \rVert + b + e_i$.

    The offset b (when the tag sent) is common and unknown, so only differences count. A table
    of differences against a reference anchor is one of pseudo-ranges with 0 for the reference:
    its covariance $\sigma^2 (I + 1 1^\top)$ is that of errors $e_i$ with a free offset.

    ``redundancy`` is the number of pseudo-ranges less the position and the offset.

    Source: Y. T. Chan, K. C. Ho, "A simple and efficient estimator for hyperbolic location",
    IEEE Transactions on Signal Processing 42(8), 1994.
    """
    used = jnp.isfinite(links.ranges)
    safe = links._replace(ranges=jnp.where(used, links.ranges, 0.0))
    size = safe.anchors.shape[1]

    def errors(point: Array) -> Array:
        misfit = safe.ranges - safe.bias - distances(safe, point[:size]) - point[size]
        return jnp.where(used, misfit / safe.std, 0.0)

    def total(point: Array) -> Array:
        return jnp.sum(errors(point) ** 2) / 2

    def normal(point: Array) -> tuple[Array, Array]:
        rows = _rows(safe, used, point[:size])
        return rows.T @ rows, rows.T @ errors(point)

    starts = _starts(safe, used)
    best = starts[jnp.argmin(jax.vmap(total)(starts))]
    point = descend(best, total, normal)
    shape = layout(safe.anchors, used)
    nowhere = jnp.full(size, jnp.nan)
    position = nearer(shape, point[:size], nowhere if near is None else near)
    cov = difference_bound(links, position)
    # Judged as ranges from here on: the offset that was found makes them such.
    corrected = links._replace(ranges=links.ranges - point[size])
    fix = finished(corrected, shape, position, cov, size + 1)
    spread = jnp.sqrt(jnp.trace(cov))
    return fix._replace(crlb=jnp.where(jnp.isnan(fix.crlb), fix.crlb, spread))


def difference_bound(links: Links, position: Float[Array, " d"]) -> Float[Array, "d d"]:
    """The Cramér-Rao bound of a position from differences: that with a free offset."""
    used = jnp.isfinite(links.ranges)
    rows = _rows(links, used, position)
    return inverse(rows.T @ rows)[:-1, :-1]


def _rows(links: Links, used: Bool[Array, " m"], position: Array) -> Float[Array, "m n"]:
    ones = jnp.ones((len(links.std), 1))
    rows = jnp.concatenate([directions(links, position), ones], axis=1)
    return rows * (used / links.std)[:, None]


def _starts(links: Links, used: Bool[Array, " m"]) -> Float[Array, "k n"]:
    """Places in a box three times as wide as the anchors, each with the offset that fits."""
    size = links.anchors.shape[1]
    inf = jnp.inf
    low = jnp.min(jnp.where(used[:, None], links.anchors, inf), axis=0)
    high = jnp.max(jnp.where(used[:, None], links.anchors, -inf), axis=0)
    reach = jnp.max(high - low)
    steps = np.array(list(itertools.product(np.linspace(-1, 1, GRID), repeat=size)))
    places = (low + high)[None] / 2 + 1.5 * reach * jnp.asarray(steps)
    count = jnp.maximum(jnp.sum(used), 1)

    def offset(place: Array) -> Array:
        gap = links.ranges - links.bias - distances(links, place)
        return jnp.sum(jnp.where(used, gap, 0.0)) / count

    return jnp.concatenate([places, jax.vmap(offset)(places)[:, None]], axis=1)
