"""A rigid body on the plane that is pushed about: nobody says where to."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Acceleration2,
    AccelerationNoise,
    Heading,
    Position,
    Scalar,
    Velocity,
    YawAcceleration,
    YawAccelerationNoise,
    YawRate,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import wrap


class State(NamedTuple):
    position: Position
    heading: Heading
    velocity: Velocity
    yaw_rate: YawRate


class Control(NamedTuple):
    """Nothing: the body is watched, not driven."""


class Noise(NamedTuple):
    acceleration: Acceleration2
    yaw_acceleration: YawAcceleration


@vehicles.add("coasting-body")
class CoastingBody(AbstractVehicle[State, Control, Noise]):
    r"""Constant velocity and constant yaw rate, disturbed by white accelerations.

    $p' = p + v \Delta t + \tfrac12 w_a \Delta t^2,\ v' = v + w_a \Delta t$, and the same for
    heading and yaw rate. The heading does not say where the body goes: a trolley on castors
    moves sideways too. With sensors that are mounted off the middle the heading is observable.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.3.2.
    """

    acceleration_noise: AccelerationNoise = 0.5
    yaw_acceleration_noise: YawAccelerationNoise = 0.5

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        push, twist = noise.acceleration * dt, noise.yaw_acceleration * dt
        return State(
            position=state.position + (state.velocity + push / 2) * dt,
            heading=wrap(state.heading + (state.yaw_rate + twist / 2) * dt),
            velocity=state.velocity + push,
            yaw_rate=state.yaw_rate + twist,
        )

    def noise_density(self) -> Noise:
        return Noise(
            jnp.full(2, self.acceleration_noise), jnp.asarray(self.yaw_acceleration_noise)
        )

    def start(self) -> State:
        return State(jnp.zeros(2), jnp.array(0.0), jnp.array([0.5, 0.2]), jnp.array(0.1))

    def nominal_control(self, time: Scalar) -> Control:
        return Control()
