"""A body that keeps its velocities: what is known of any vehicle in water or air."""

import math
from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Acceleration3,
    AccelerationNoise,
    AngularAcceleration3,
    AngularRate3,
    Attitude,
    Position3,
    Scalar,
    Velocity3,
    YawAccelerationNoise,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import exp, multiply, rotate


class State(NamedTuple):
    """Of any rigid body; that of "underwater" too, so that both can be filters of one study."""

    position: Position3
    """East, north, up; of an underwater vehicle's centre of buoyancy."""
    attitude: Attitude
    velocity_body: Velocity3
    """Over ground: forward, left, up."""
    angular_rate: AngularRate3


class Control(NamedTuple):
    """Nothing: the vehicle is watched, not driven."""


class Noise(NamedTuple):
    """Means over a step, and what they do not tell of the way between."""

    acceleration: Acceleration3
    angular_acceleration: AngularAcceleration3
    between: Acceleration3
    angular_between: AngularAcceleration3


BRIDGE = 1 / math.sqrt(12)
r"""The integral of white noise twice has the covariance of its mean's, and this times $dt^2$ of
an independent noise: $dt^3/3 = dt^3/4 + dt^3/12$."""


@vehicles.add("body-twist")
class BodyTwist(AbstractVehicle[State, Control, Noise]):
    r"""Velocity and angular rate of the body wander, each driven by white noise.

    $\dot p = R(q)\, v_b,\ \dot q = q \otimes \omega / 2,\ \dot v_b = w_v,\
    \dot\omega = w_\omega$, by the midpoint rule.

    The noise of a step has the covariance of the continuous motion: positions and angles are
    not tied to the velocities' noise, as they would be by one acceleration for a whole step,
    which matters where exact angles come seldom.

    It knows nothing of forces, so it is never wrong about them: with velocities and angles
    measured it is the motion model of a navigation filter, and the baseline that a hydrodynamic
    model has to beat.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.2.2 (white-noise acceleration), here in the body.
    """

    acceleration_noise: AccelerationNoise = 0.1
    angular_noise: YawAccelerationNoise = 0.1

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        velocity = state.velocity_body + (noise.acceleration / 2 + BRIDGE * noise.between) * dt
        angular = noise.angular_acceleration / 2 + BRIDGE * noise.angular_between
        rate = state.angular_rate + angular * dt
        middle = multiply(state.attitude, exp(rate * dt / 2))
        attitude = multiply(middle, exp(rate * dt / 2))
        return State(
            position=state.position + rotate(middle, velocity) * dt,
            attitude=attitude / jnp.sqrt(attitude @ attitude),
            velocity_body=state.velocity_body + noise.acceleration * dt,
            angular_rate=state.angular_rate + noise.angular_acceleration * dt,
        )

    def noise_density(self) -> Noise:
        linear, angular = jnp.full(3, self.acceleration_noise), jnp.full(3, self.angular_noise)
        return Noise(linear, angular, linear, angular)

    def start(self) -> State:
        level = jnp.array([1.0, 0.0, 0.0, 0.0])
        return State(jnp.zeros(3), level, jnp.array([1.5, 0.0, 0.0]), jnp.zeros(3))

    def nominal_control(self, time: Scalar) -> Control:
        return Control()
