"""Strapdown inertial navigation on the ellipsoid: earth rate, transport rate, real gravity."""

from typing import Any

import jax.numpy as jnp

from kedge.core.quantities import Metres, Radians, Scalar
from kedge.core.registry import vehicles
from kedge.core.rotations import rotate
from kedge.numerics.earth import Origin, earth_spin, gravity, radii
from kedge.vehicles.strapdown import (
    AbstractStrapdown,
    Imu,
    State,
    in_first_axes,
    in_turned_map,
    turned,
)


@vehicles.add("strapdown-geodetic")
class GeodeticStrapdown(AbstractStrapdown):
    r"""Position, velocity and attitude on the ellipsoid WGS 84, in axes east, north, up.

    $\dot v = R f + g - (2 \omega_{ie} + \omega_{en}) \times v$, and the map's axes turn with
    $\omega_{ie} + \omega_{en}$, where $\omega_{en} = [-v_N / (R_M + h), v_E / (R_N + h),
    v_E \tan L / (R_N + h)]$ keeps them level. The rates are those of the middle of the step.
    Position is longitude, latitude and height in metres from an origin
    (:class:`kedge.numerics.earth.Origin`); velocity and attitude are in the level axes where
    the vehicle is. The usual form in axes north, east, down is the same with other signs; at
    the poles both fail.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 5.4.
    """

    latitude: Radians = 0.8
    """Of the map's origin."""
    height: Metres = 0.0

    def step(self, state: State, control: Any, noise: Imu, dt: Scalar) -> State:
        increments = self.increments(control, noise, dt)
        attitude = jnp.asarray(state.attitude)
        origin = Origin(self.latitude, 0.0, self.height)
        east, north = origin.scales()
        latitude, _, height = origin.from_map(state.position)

        # Where and how fast the vehicle is in the middle of the step, to first order.
        level = jnp.zeros(2)
        fall = jnp.append(level, -gravity(latitude, height) * dt)
        speed = state.velocity + (rotate(attitude, increments.delta_velocity) + fall) / 2
        latitude = latitude + speed[1] * dt / 2 / (radii(latitude).meridian + height)
        height = height + speed[2] * dt / 2

        meridian, transverse = (radius + height for radius in radii(latitude))
        spin = earth_spin(latitude)
        transport = jnp.stack(
            [
                -speed[1] / meridian,
                speed[0] / transverse,
                speed[0] * jnp.tan(latitude) / transverse,
            ]
        )
        fall = jnp.append(level, -gravity(latitude, height) * dt)
        turning = (spin + transport) * dt
        delta_velocity, delta_position = in_first_axes(attitude, turning, increments)
        fall = fall - jnp.cross(2 * spin + transport, speed) * dt
        mean = state.velocity + delta_position + fall / 2
        ways = jnp.stack(
            [east / (transverse * jnp.cos(latitude)), north / meridian, jnp.ones(())]
        )
        return State(
            position=state.position + ways * mean * dt,
            velocity=state.velocity + delta_velocity + fall,
            attitude=turned(in_turned_map(attitude, turning), increments.delta_angle),
        )

    def start(self) -> State:
        return State(jnp.zeros(3), jnp.array([5.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0, 0.0]))
