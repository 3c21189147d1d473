"""Strapdown inertial navigation in a local tangent frame: the IMU drives the state."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractOdeVehicle
from kedge.core.quantities import (
    Acceleration3,
    AccelerationNoise,
    AngularRate3,
    Attitude,
    Position3,
    Scalar,
    Velocity3,
    YawRateNoise,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import rotate

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2 in the east-north-up map frame


class State(NamedTuple):
    position: Position3
    velocity: Velocity3
    attitude: Attitude


class Imu(NamedTuple):
    specific_force: Acceleration3
    angular_rate: AngularRate3


@vehicles.add("strapdown")
class Strapdown(AbstractOdeVehicle[State, Imu, Imu]):
    r"""Position, velocity and attitude from gyroscopes and accelerometers.

    $\dot p = v,\ \dot v = R(q) (f - w_f) + g,\ \dot q = q \otimes (\omega - w_\omega) / 2$.

    Source: J. Solà, "Quaternion kinematics for the error-state Kalman filter", 2017,
    arXiv 1711.02508, section 5.1.
    """

    accelerometer_noise: AccelerationNoise = 0.05
    gyroscope_noise: YawRateNoise = 0.005

    def rates(self, state: State, control: Imu, noise: Imu) -> State:
        force = control.specific_force - noise.specific_force
        return State(
            position=state.velocity,
            velocity=rotate(state.attitude, force) + jnp.array(GRAVITY),
            attitude=control.angular_rate - noise.angular_rate,
        )

    def noise_density(self) -> Imu:
        return Imu(jnp.full(3, self.accelerometer_noise), jnp.full(3, self.gyroscope_noise))

    def start(self) -> State:
        return State(jnp.zeros(3), jnp.array([5.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0, 0.0]))

    def drive(self, time: Scalar) -> Imu:
        turn = 0.5 * jnp.sin(0.4 * time)
        force = jnp.stack([jnp.cos(0.7 * time), 5.0 * turn, jnp.full_like(turn, 9.81)])
        return Imu(force, jnp.stack([jnp.zeros_like(turn), jnp.zeros_like(turn), turn]))
