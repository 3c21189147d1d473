"""One epoch of ranges, and which of them can be used."""

import enum
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class Use(enum.IntEnum):
    """Why a range is used, or is not."""

    USED = 0
    MISSING = 1
    """NaN: the anchor was not heard."""
    NOT_POSITIVE = 2
    """Zero, negative or infinite, as it is or less its known bias."""
    SHORT = 3
    """Shorter than the difference of height."""


class Links(NamedTuple):
    r"""The ranges of one epoch: $D_i = \sqrt{\lVert x - a_i \rVert^2 + h_i^2} + \mu_i + e_i$.

    The errors $e_i$ are independent, of mean 0 and standard deviation $\sigma_i$.
    """

    anchors: Float[Array, "m d"]
    """In 2 or 3 dimensions, m."""
    ranges: Float[Array, " m"]
    """NaN where an anchor was not heard, m."""
    std: Float[Array, " m"]
    bias: Float[Array, " m"]
    r"""What is expected of the mean error $\mu_i$: the excess behind an obstacle, m."""
    rise: Float[Array, " m"]
    """Height of the tag over each anchor where it is known and x is horizontal, m."""


def links(anchors: Any, ranges: Any, std: Any = 0.1, bias: Any = 0.0, rise: Any = 0.0) -> Links:
    """An epoch, with one number for all anchors where they share it."""
    anchors, ranges = jnp.asarray(anchors, float), jnp.asarray(ranges, float)
    count = anchors.shape[0]

    def each(value: Any) -> Array:
        return jnp.broadcast_to(jnp.asarray(value, float), (count,))

    return Links(anchors, each(ranges), each(std), each(bias), each(rise))


def use_of(links: Links) -> Int[Array, " m"]:
    """Which ranges can be used, and why others cannot."""
    length = links.ranges - links.bias
    use = jnp.where(length < jnp.abs(links.rise), Use.SHORT, Use.USED)
    positive = (links.ranges > 0) & (length > 0) & jnp.isfinite(links.ranges)
    use = jnp.where(positive, use, Use.NOT_POSITIVE)
    return jnp.where(jnp.isnan(links.ranges), Use.MISSING, use)


def usable(links: Links) -> tuple[Links, Bool[Array, " m"]]:
    """The epoch with harmless numbers in place of what cannot be used, and what can."""
    used = use_of(links) == Use.USED
    safe = jnp.where(used, links.ranges, links.bias + jnp.abs(links.rise) + 1.0)
    return links._replace(ranges=safe), used


def distances(links: Links, position: Float[Array, " d"]) -> Float[Array, " m"]:
    """From a position to every anchor, m."""
    away = position[None] - links.anchors
    return jnp.sqrt(jnp.sum(away**2, axis=1) + links.rise**2)


def residuals(links: Links, position: Float[Array, " d"]) -> Float[Array, " m"]:
    """Measured less expected, m; NaN where there is no range."""
    return links.ranges - links.bias - distances(links, position)


def directions(links: Links, position: Float[Array, " d"]) -> Float[Array, "m d"]:
    """How each distance changes with the position; 0 at an anchor itself."""
    away = position[None] - links.anchors
    length = distances(links, position)
    return away / jnp.where(length > 0, length, 1.0)[:, None]
