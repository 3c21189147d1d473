"""Mounts: the state of a vehicle as a sensor on it meets it."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from kedge.core.manifolds import Chart
from kedge.core.quantities import Scalar
from kedge.core.rotations import conjugate, multiply, rotate, wrap

PLANE, SPACE = {"position", "heading"}, {"position", "attitude"}
MOVING = ("velocity", "velocity_body")
"""Fields that a lever arm changes while the vehicle turns."""


class Mount(NamedTuple):
    """Where a sensor sits (m: forward, left, up of the origin) and how it is turned (rad).

    It is turned to the left by ``heading``, then nose down by ``pitch`` about its own left
    axis, then right side down by ``roll`` about its own forward axis. On a vehicle in the plane
    height, roll and pitch are zero.
    """

    x: Scalar = 0.0
    y: Scalar = 0.0
    heading: Scalar = 0.0
    z: Scalar = 0.0
    roll: Scalar = 0.0
    pitch: Scalar = 0.0

    @property
    def arm(self) -> Float[Array, "3"]:
        """From the vehicle's origin to the sensor, in the body frame."""
        return jnp.stack([jnp.asarray(part, float) for part in (self.x, self.y, self.z)])

    @property
    def body_from_sensor(self) -> Float[Array, "4"]:
        """The quaternion that turns the sensor's axes into the body's."""
        turned = jnp.array([1.0, 0.0, 0.0, 0.0])
        for axis, angle in ((2, self.heading), (1, self.pitch), (0, self.roll)):
            half = jnp.asarray(angle, float) / 2
            parts = [jnp.cos(half), *[jnp.zeros(())] * 3]
            parts[1 + axis] = jnp.sin(half)
            turned = multiply(turned, jnp.stack(parts))
        return turned


def seen_from(mount: Mount, state: Any) -> Any:
    r"""The state as if the vehicle's origin were where the sensor sits, turned as it is.

    In space $p + R l$, $R\,R_s$, $v + R (\omega \times l)$, and for what is told in the body
    frame $R_s^\top (v_b + \omega \times l)$, $R_s^\top \omega$. Velocities move with the arm
    only if the state knows its angular rate: :func:`validation_error` refuses the others.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 2.5.5 (lever arms).
    """
    if not hasattr(state, "attitude"):
        cos, sin = jnp.cos(state.heading), jnp.sin(state.heading)
        arm = jnp.stack([cos * mount.x - sin * mount.y, sin * mount.x + cos * mount.y])
        return state._replace(
            position=state.position + arm, heading=wrap(state.heading + mount.heading)
        )
    turned, arm, attitude = mount.body_from_sensor, mount.arm, state.attitude
    at_mount = {
        "position": state.position + rotate(attitude, arm),
        "attitude": multiply(attitude, turned),
    }
    rate = getattr(state, "angular_rate", None)
    swing = jnp.zeros(3) if rate is None else jnp.cross(rate, arm)
    if rate is not None:
        at_mount["angular_rate"] = rotate(conjugate(turned), rate)
        if hasattr(state, "velocity"):
            at_mount["velocity"] = state.velocity + rotate(attitude, swing)
    if hasattr(state, "velocity_body"):
        at_mount["velocity_body"] = rotate(conjugate(turned), state.velocity_body + swing)
    return state._replace(**at_mount)


def validation_error(mount: Mount, has: dict[str, Chart], reads: set[str]) -> str | None:
    """Why a sensor cannot sit there on a vehicle whose state has these fields."""
    if not (has.keys() >= PLANE or has.keys() >= SPACE):
        return (
            "has a mount, which needs position and heading (in space: and attitude) in the "
            "state, but the state of {vehicle} is " + str(sorted(has))
        )
    if not has.keys() >= SPACE:
        for name in ("z", "roll", "pitch"):
            if _is_set(getattr(mount, name)):
                return (
                    f"has a mount with {name} = {getattr(mount, name):g}, but "
                    "{vehicle} moves in the plane; expected 0"
                )
        return None
    swung = [name for name in MOVING if name in reads and name in has]
    if swung and "angular_rate" not in has and any(map(_is_set, (mount.x, mount.y, mount.z))):
        return (
            f"reads {swung[0]} at the end of a lever arm, which needs angular_rate in the "
            "state, but the state of {vehicle} is " + str(sorted(has))
        )
    return None


def _is_set(value: Scalar) -> bool:
    # Under tracing nobody can tell, and what is traced was checked before.
    return not isinstance(value, Tracer) and bool(np.any(np.asarray(value) != 0))
