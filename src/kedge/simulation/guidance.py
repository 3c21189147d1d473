"""Guidance: what to do, from where something ought to be and is believed to be."""

import dataclasses
from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from kedge.core.quantities import (
    Acceleration,
    Curvature,
    Heading,
    Metres,
    Position,
    Radians,
    Scalar,
    SteeringAngle,
    Velocity,
    YawRate,
)
from kedge.core.rotations import wrap
from kedge.numerics.exponential import held_inputs
from kedge.numerics.linalg import cholesky, gain, symmetric
from kedge.simulation.routes import Place
from kedge.vehicles.lateral_tracking import AbstractLateral, LinearLateralTracking, State

L = TypeVar("L", bound=AbstractLateral)
SWEEPS = 1500
"""Of the Riccati equation: what is left of the start shrinks with the square of the slowest
mode in each, so modes that decay within 100 steps are settled to rounding."""


def follow(
    place: Place, position: Position, heading: Heading, gain: Scalar, turn_gain: Scalar
) -> tuple[Velocity, YawRate]:
    r"""The velocity (in the map) and yaw rate that lead back to a place of a route.

    $v = \dot p_r + k_p (p_r - \hat p)$ and $\omega = \dot\theta_r + k_\theta\,
    \mathrm{wrap}(\theta_r - \hat\theta)$ with gains in 1/s.

    Source: K. Lynch, F. Park, "Modern Robotics", 2017, section 11.3 (feedforward and
    proportional control of the velocity).
    """
    velocity = place.velocity + gain * (place.position - position)
    return velocity, place.yaw_rate + turn_gain * wrap(place.heading - heading)


def regulator(
    F: Float[Array, "n n"],
    G: Float[Array, "n m"],
    state_weight: Float[Array, "n n"],
    input_weight: Float[Array, "m m"],
) -> Float[Array, "m n"]:
    r"""The gain K of $u = -K x$ that minimises $\sum_k x_k^\top Q x_k + u_k^\top R u_k$.

    $K = (R + G^\top P G)^{-1} G^\top P F$ with the solution of Riccati's equation
    $P = Q + F^\top P (F - G K)$, which is swept from $P = Q$ on.

    Source: B. Anderson and J. Moore, "Optimal Control: Linear Quadratic Methods", 1990,
    section 2.4.
    """

    def gain_of(P: Float[Array, "n n"]) -> Float[Array, "m n"]:
        cost = symmetric(input_weight + G.T @ P @ G)
        return gain(F.T @ P @ G, cholesky(cost)).T

    def sweep(_: Any, P: Float[Array, "n n"]) -> Float[Array, "n n"]:
        return symmetric(state_weight + F.T @ P @ (F - G @ gain_of(P)))

    return gain_of(lax.fori_loop(0, SWEEPS, sweep, state_weight))


def steady_turn(vehicle: AbstractLateral, curvature: Curvature) -> tuple[State, SteeringAngle]:
    r"""The state in a steady turn on a path of this curvature, and its steering angle.

    $r = \kappa v$, both tyre equations at rest, and $e_\varphi = -v_y / v$: the car does not
    point along the path, since its rear tyres need their slip.

    Source: R. Rajamani, "Vehicle Dynamics and Control", 2nd ed., 2012, section 3.2.
    """
    (a, b, c), (d, e, f) = vehicle.tyres()
    rate = curvature * jnp.asarray(vehicle.speed)
    # Cramer's rule for [a c; d f] [v_y; delta] = -[b; e] r.
    scale = rate / (a * f - c * d)
    slip, steering = (c * e - b * f) * scale, (b * d - a * e) * scale
    none = jnp.zeros_like(rate)
    return State(slip, rate, none, -slip / vehicle.speed, none), steering


class LaneKeeper(NamedTuple):
    r"""Steering by a quadratic regulator about the steady turn, and braking by the speed.

    $\delta = \delta_\kappa - K ([v_y, r, e_y, e_\varphi] - [v_y, r, 0, e_\varphi]_\kappa)$
    within the limit, and $a = -k_v e_v$; $\kappa$ marks the steady turn.
    """

    vehicle: AbstractLateral
    gains: Float[Array, "4"]
    limit: SteeringAngle
    speed_gain: Scalar  # 1/s

    def command(
        self, believed: State, curvature: Curvature
    ) -> tuple[SteeringAngle, Acceleration]:
        """Steering angle and acceleration."""
        target, ahead = steady_turn(self.vehicle, curvature)
        off = jnp.stack(
            [jnp.asarray(a - b) for a, b in zip(believed[:4], target[:4], strict=True)]
        )
        steering = jnp.clip(ahead - self.gains @ off, -self.limit, self.limit)
        return steering, -self.speed_gain * believed.speed_error


def like(vehicle: AbstractLateral, form: type[L]) -> L:
    """The same car in another form."""
    fields = dataclasses.fields(AbstractLateral)
    return form(**{field.name: getattr(vehicle, field.name) for field in fields})


def lane_keeper(
    vehicle: AbstractLateral,
    dt: float,
    offset_scale: Metres,
    heading_scale: Radians,
    steering_scale: SteeringAngle,
    limit: SteeringAngle,
    speed_gain: Scalar,
) -> LaneKeeper:
    """A lane keeper for a car whose commands are held for ``dt``.

    The scales are what an offset, a heading error and a steering angle of equal cost are.
    """
    A, B = like(vehicle, LinearLateralTracking).system()
    F, G = held_inputs(A, B, dt)
    scales = jnp.stack(
        [jnp.asarray(s) for s in (jnp.inf, jnp.inf, offset_scale, heading_scale)]
    )
    weight = 1 / jnp.full((1, 1), steering_scale) ** 2
    gains = regulator(F[:4, :4], G[:4, :1], jnp.diag(1 / scales**2), weight)
    return LaneKeeper(vehicle, gains[0], limit, speed_gain)
