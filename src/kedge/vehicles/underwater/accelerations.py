"""What a hull's velocities change by, with the exact slope that filters linearise by."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from kedge.vehicles.underwater.hydrodynamics import FEATURES, features

STARTS = [FEATURES.index(name) for name in ("u|u|", "down_x", "thrust", "uu rudder")]
SIGNED, DOWN, DRIVEN, FINS = map(slice, STARTS, [*STARTS[1:], len(FEATURES)])
"""Where among the features the signed squares stand, and so on; products are before them."""


@jax.custom_jvp
def accelerations(
    reply: Float[Array, "6 f"],
    velocity: Float[Array, "6"],
    down: Float[Array, "3"],
    commands: Float[Array, "4"],
) -> Float[Array, "6"]:
    r"""``reply`` times the features: $T : x x + D\, x|x| + b$.

    Whoever differentiates it gets $\partial / \partial x = 2\,T \cdot x + 2\,D\,
    \operatorname{diag}|x|$ as one matrix, instead of 49 features for each direction: so the
    extended filter takes a third less time for an event of the 6-DOF vehicle.

    Args:
        reply: of :func:`kedge.vehicles.underwater.hydrodynamics.response`.
        velocity: u, v, w (m/s, through the water), p, q, r (rad/s).
        down: the unit vector of gravity, in the body.
        commands: thrust (N), roll torque (N m), rudder and stern plane (rad).
    """
    return reply @ features(velocity, down, commands)


def slope(
    reply: Float[Array, "6 f"], velocity: Float[Array, "6"], commands: Float[Array, "4"]
) -> Float[Array, "6 6"]:
    """The derivative of the accelerations by the velocities, fins included."""
    size = len(velocity)
    tensor = reply[:, : SIGNED.start].reshape(size, size, size)
    both = tensor + tensor.transpose(0, 2, 1)
    pairs = jnp.sum(both * velocity[None, None], axis=2)
    drag = 2 * reply[:, SIGNED] * jnp.abs(velocity)[None]
    steered = 2 * velocity[0] * (reply[:, FINS] @ commands[2:])
    return (pairs + drag).at[:, 0].add(steered)


def _along(
    at: tuple[Array, Array, Array, Array], by: tuple[Any, Any, Any, Any]
) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
    """The accelerations and how they change; what does not change costs nothing."""
    reply, velocity, down, commands = at
    change = jnp.zeros_like(velocity)
    if not isinstance(by[0], SymbolicZero):
        change = change + by[0] @ features(velocity, down, commands)
    if not isinstance(by[1], SymbolicZero):
        change = change + slope(reply, velocity, commands) @ by[1]
    if not isinstance(by[2], SymbolicZero):
        change = change + reply[:, DOWN] @ by[2]
    if not isinstance(by[3], SymbolicZero):
        fins = velocity[0] ** 2 * (reply[:, FINS] @ by[3][2:])
        change = change + reply[:, DRIVEN] @ by[3][:2] + fins
    return accelerations(reply, velocity, down, commands), change


accelerations.defjvp(_along, symbolic_zeros=True)
