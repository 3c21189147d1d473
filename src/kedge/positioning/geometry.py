"""How anchors lie: in general position, or on a line (in 3-D a plane) that mirrors a fix."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

THIN = 1e-3
"""Anchors are flat if their thickness is less than this share of their width."""


class Layout(NamedTuple):
    """The line (plane) nearest to the anchors that are used."""

    centre: Float[Array, " d"]
    axes: Float[Array, "d d"]
    """Columns: the normal, then the directions along."""
    flat: Bool[Array, ""]
    """Whether the anchors lie on it, so that ranges do not say on which side the tag is."""


def layout(anchors: Float[Array, "m d"], used: Bool[Array, " m"]) -> Layout:
    """Principal axes of the anchors that are used; as many as there are dimensions are flat."""
    weights = used / jnp.maximum(jnp.sum(used), 1)
    centre = weights @ anchors
    away = anchors - centre[None]
    spread, axes = jnp.linalg.eigh(away.T @ (weights[:, None] * away))
    flat = spread[0] <= THIN**2 * spread[-1]
    return Layout(centre, axes, flat)


def mirrored(layout: Layout, position: Float[Array, " d"]) -> Float[Array, " d"]:
    """The position on the other side."""
    normal = layout.axes[:, 0]
    return position - 2 * normal * (normal @ (position - layout.centre))


def nearer(
    layout: Layout, position: Float[Array, " d"], near: Float[Array, " d"]
) -> Float[Array, " d"]:
    """Of a position and its mirror image the one nearer to ``near``, else the lower one."""
    other = mirrored(layout, position)
    closer = jnp.sum((other - near) ** 2) < jnp.sum((position - near) ** 2)
    lower = other[-1] < position[-1]
    swap = layout.flat & jnp.where(jnp.isnan(near).any(), lower, closer)
    return jnp.where(swap, other, position)
