"""The way of a body in the plane that keeps its twist."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.quantities import Heading, Position, Scalar
from kedge.core.rotations import direction, wrap


class State(NamedTuple):
    """A pose in the plane."""

    position: Position
    heading: Heading


def along_arc(state: State, ahead: Scalar, aside: Scalar, turn: Scalar) -> State:
    r"""A pose after ways ahead and aside (m, in the body) and a turn (rad), all at even speed.

    $p' = p + \operatorname{sinc}(\theta/2)\, \mathrm{Rot}(\psi + \theta/2)\, d$.

    Source: K. Lynch, F. Park, "Modern Robotics", 2017, section 13.4 (odometry).
    """
    middle = state.heading + turn / 2
    way = ahead * direction(middle) + aside * direction(middle + jnp.pi / 2)
    return State(
        position=state.position + _chord(turn / 2) * way,
        heading=wrap(state.heading + turn),
    )


def _chord(half: Scalar) -> Float[Array, ""]:
    r"""$\sin h / h$; ``jnp.sinc`` has wrong derivatives where a turn is 1e-13 and not 0."""
    squared = jnp.asarray(half) ** 2
    small = squared < 1e-4
    safe = jnp.where(small, 1.0, half)
    series = 1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42))
    return jnp.where(small, series, jnp.sin(safe) / safe)
