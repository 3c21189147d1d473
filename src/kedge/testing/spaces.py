"""Values against the charts of their spaces: layouts, random points, differences."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.manifolds import Circle, Rotation, Space, ranges_of, space_of
from kedge.testing.laws import Require

POINTS = 16
"""Random points at which a law is tried."""
DIFFERENCE = 1e-5
"""Half the step of central differences."""


def charted_class(require: Require, name: str, cls: Any) -> Space:
    """The space of a class, which must be a ``NamedTuple`` of quantities."""
    require(
        f"{name} is a NamedTuple class of quantities",
        isinstance(cls, type) and issubclass(cls, tuple) and hasattr(cls, "_fields"),
        found=cls,
    )
    return space_of(cls)


def charted(
    require: Require, name: str, value: Any, tangent: bool = False, of: Any = None
) -> Space:
    """The space of a value, whose shapes must be those of its charts."""
    found = charted_class(require, f"type of {name}", type(value))
    require(f"{name} is always of one type", of in (None, type(value)), type(value), of)
    expected = [chart.tangent_shape if tangent else chart.shape for chart in found.charts]
    shapes = [np.shape(leaf) for leaf in value]
    require(f"{name} has the shapes of its quantities", shapes == expected, shapes, expected)
    return found


def layout(tree: Any) -> Any:
    """Structure, shapes and dtypes of a tree."""
    leaves, structure = jax.tree.flatten(tree)
    return str(structure), [(np.shape(leaf), str(jnp.result_type(leaf))) for leaf in leaves]


def require_layout(
    require: Require, law: str, value: Any, cls: Any, expected: list[tuple[Any, Any]]
) -> None:
    """A value is of a class and has the shapes and dtypes expected (None: any dtype)."""
    require(law, type(value) is cls, type(value), cls)
    found = [
        (np.shape(leaf), None if dtype is None else str(jnp.result_type(leaf)))
        for leaf, (_, dtype) in zip(value, expected, strict=True)
    ]
    require(law, found == expected, found, expected)


def float_name() -> str:
    """Name of the floats that are computed with."""
    return str(jnp.result_type(float))


def origin_of(found: Space) -> Any:
    """A point of any space: where each chart puts what is missing."""
    missing = found.cls(*(jnp.full(chart.shape, jnp.nan) for chart in found.charts))
    return found.complete(missing)[0]


def tangents(found: Space, key: PRNGKeyArray, seam: bool = False) -> Float[Array, "k n"]:
    """Random tangent vectors; with ``seam``, every other one turns by nearly half a turn."""
    white = jr.normal(key, (POINTS, found.size))
    if not seam:
        return white
    short = jnp.asarray([1e-2, 1e-4, 1e-7, 1e-9])[jnp.arange(POINTS) // 2 % 4]
    near = jnp.where(jnp.arange(POINTS) % 4 < 2, 1, -1) * (jnp.pi - short)
    at_seam = (jnp.arange(POINTS) % 2 == 1)[:, None]
    parts = []
    for chart, part in zip(found.charts, found.slices().values(), strict=True):
        piece = white[:, part]
        if isinstance(chart, Circle):
            # Without the seam too, an angle's differences are shorter than half a turn.
            piece = jnp.where(at_seam, near[:, None], jnp.pi * jnp.tanh(piece) * 0.9)
        elif isinstance(chart, Rotation):
            axis = piece / jnp.linalg.norm(piece, axis=1, keepdims=True)
            length = jnp.pi * 0.9 * jnp.tanh(jnp.linalg.norm(piece, axis=1, keepdims=True))
            piece = axis * jnp.where(at_seam, near[:, None], length)
        parts.append(piece)
    return jnp.concatenate([jnp.zeros((POINTS, 0)), *parts], axis=1)


MIDDLE = 0.8
"""Share of a field's range in which states are tried: a step must not cross its ends."""


def states_about(found: Space, base: Any, deltas: Float[Array, "k n"]) -> Any:
    """States at tangent vectors from ``base``; where a field has a range, inside that."""
    points = jax.vmap(found.boxplus, (None, 0))(base, deltas)
    inside = {}
    for name, limits in ranges_of(found.cls).items():
        share = jax.nn.sigmoid(getattr(points, name)) - 0.5
        middle, length = (limits.low + limits.high) / 2, limits.high - limits.low
        inside[name] = middle + MIDDLE * length * share
    return points._replace(**inside)


def slope_gap(
    function: Callable[[Array], Any], values: Space, jacobian: Float[Array, "m n"]
) -> Array:
    """How far a Jacobian at the origin is from central differences, relative to its largest."""
    size = jacobian.shape[1]
    shifts = DIFFERENCE * jnp.concatenate([jnp.zeros((1, size)), jnp.eye(size), -jnp.eye(size)])
    points = jax.vmap(function)(shifts)
    moves = jax.vmap(values.boxminus, (0, None))(points, row(points, 0))
    slope = (moves[1 : size + 1] - moves[size + 1 :]).T / (2 * DIFFERENCE)
    return jnp.abs(jacobian - slope).max() / jnp.maximum(jnp.abs(slope).max(), 1.0)


def row(tree: Any, index: int | slice | tuple[int, ...]) -> Any:
    """One row, or element, of every leaf."""
    return jax.tree.map(lambda leaf: leaf[index], tree)
