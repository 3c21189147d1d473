"""An underwater vehicle's autopilot: heading, depth and speed loops."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.quantities import Radians, Scalar
from kedge.core.rotations import matrix_of, wrap
from kedge.vehicles.underwater.hydrodynamics import Coefficients
from kedge.vehicles.underwater.underwater import Control


class Target(NamedTuple):
    """What is asked of the vehicle."""

    heading: Float[Array, ""]  # rad, counter-clockwise from east
    yaw_rate: Float[Array, ""]  # rad/s
    depth: Float[Array, ""]  # m
    sinking: Float[Array, ""]  # m/s
    speed: Float[Array, ""]  # m/s, ahead


class Autopilot(eqx.Module):
    r"""Proportional loops with damping by the rates, about the trim of straight travel.

    Rudder $\delta_r = k_\psi (\psi_d - \psi) + k_r (r_d - r)$; pitch
    $\theta_d = \theta_0 - (\dot z_d / u + k_z (z_d - z))$ within ``pitch_limit``; stern plane
    $\delta_s = \delta_0 + k_\theta (\theta - \theta_d) + k_q q$ (nose up positive); thrust is
    the drag at the speed that is wanted, and $k_u (u_d - u)$. The propeller's torque goes with
    its thrust. The trim $\theta_0, \delta_0$ is where weight, lift and fins are in balance.

    Source: T. Fossen, "Handbook of Marine Craft Hydrodynamics and Motion Control", 2011,
    section 12.2 (autopilots with proportional and rate feedback); the gains are kedge's.
    """

    heading_gain: Scalar = 1.0
    yaw_rate_gain: Scalar = 1.0  # s
    depth_gain: Scalar = 0.15  # rad/m
    pitch_gain: Scalar = 1.0
    pitch_rate_gain: Scalar = 1.0  # s
    pitch_limit: Radians = 0.45
    speed_gain: Scalar = 15.0  # N s/m
    most_thrust: Scalar = 12.0  # N

    def command(self, hull: Coefficients, believed: Any, target: Target) -> Control:
        """Thrust, torque and fins; the fins as asked for, whatever their limit."""
        turn, rate = matrix_of(believed.attitude), believed.angular_rate
        heading = jnp.arctan2(turn[1, 0], turn[0, 0])
        pitch = jnp.arcsin(jnp.clip(turn[2, 0], -1.0, 1.0))
        off = wrap(target.heading - heading)
        rudder = self.heading_gain * off + self.yaw_rate_gain * (target.yaw_rate - rate[2])

        speed = jnp.maximum(target.speed, 0.3)  # at rest no fin holds anything
        level, held = trim(hull, speed)
        below = believed.position[2] + target.depth
        wanted = level - (target.sinking / speed + self.depth_gain * below)
        wanted = jnp.clip(wanted, -self.pitch_limit, self.pitch_limit)
        stern = held + self.pitch_gain * (pitch - wanted) - self.pitch_rate_gain * rate[1]

        lacking = target.speed - believed.velocity_body[0]
        thrust = -hull.Xuu * target.speed**2 + self.speed_gain * lacking
        thrust = jnp.clip(thrust, 0.0, self.most_thrust)
        return Control(thrust, hull.Kprop / hull.Xprop * thrust, rudder, stern)


def trim(hull: Coefficients, speed: Scalar) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""Pitch (nose up) and stern plane in rad with which straight travel stays level.

    For small angles, with $w = u \theta$:
    $(W - B) + Z_{uw} u^2 \theta + Z_{uu\delta} u^2 \delta = 0$ and
    $(M_{uw} u^2 - z_G W + z_B B)\,\theta - (x_G W - x_B B) + M_{uu\delta} u^2 \delta = 0$.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, section 8.2 (the linearised depth plane).
    """
    c, uu = hull, jnp.asarray(speed) ** 2
    lift, fin = c.Zuw * uu, c.Zuuds * uu
    turning, lever = c.Muw * uu - c.zG * c.weight + c.zB * c.buoyancy, c.Muuds * uu
    force = c.buoyancy - c.weight
    moment = c.xG * c.weight - c.xB * c.buoyancy
    scale = 1 / (lift * lever - fin * turning)
    pitch = (force * lever - fin * moment) * scale
    return pitch, (lift * moment - turning * force) * scale
