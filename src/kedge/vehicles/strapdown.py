"""Strapdown inertial navigation: an inertial measurement unit (IMU) drives the state.

What all forms share: the errors of the IMU, and what a step of its readings amounts to. With
augmented states for the two biases any of them is the 15-state error-state filter.
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Acceleration,
    Acceleration3,
    AccelerationNoise,
    AccelerationOffset3,
    AngularRate3,
    AngularRateOffset3,
    Attitude,
    Position3,
    Radians,
    Ratio3,
    Scalar,
    Seconds,
    Velocity3,
    YawRateNoise,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import exp, multiply, rotate
from kedge.numerics.earth import earth_spin

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2 in the east-north-up map frame


class State(NamedTuple):
    position: Position3
    velocity: Velocity3
    attitude: Attitude


class RatedState(NamedTuple):
    position: Position3
    velocity: Velocity3
    attitude: Attitude
    angular_rate: AngularRate3


class Imu(NamedTuple):
    specific_force: Acceleration3
    angular_rate: AngularRate3


class ImuWithSlopes(NamedTuple):
    """Means over a step, and how fast they change within it (in their unit per second)."""

    specific_force: Acceleration3
    angular_rate: AngularRate3
    specific_force_slope: Acceleration3
    angular_rate_slope: AngularRate3


class Increments(NamedTuple):
    """Increments of a step, in the body's axes at its beginning."""

    delta_angle: Float[Array, "3"]
    """Rotation vector, rad."""
    delta_velocity: Float[Array, "3"]
    """m/s."""
    delta_position: Float[Array, "3"]
    """What the force adds to the position by the end, divided by the step, m/s."""


class AbstractStrapdown(AbstractVehicle[Any, Any, Imu]):
    r"""A state driven by what gyroscopes and accelerometers read.

    They read $\tilde\omega = (1 + s_\omega) \omega + b_\omega + w_\omega$ and likewise the
    specific force f; biases and scale errors are one number, or augmented states with one for
    each axis. Readings are held over a step. With ``slopes`` the log gives their change within
    it too (``control.sampling``), and coning and sculling are compensated.

    Source: P. Savage, "Strapdown inertial navigation integration algorithm design", J. Guid.
    Control Dyn. 21(1) and 21(2), 1998, equations 47 (coning) and 21 (sculling), for readings
    that are linear within a step.
    """

    accelerometer_noise: AccelerationNoise = 0.05
    gyroscope_noise: YawRateNoise = 0.005
    accelerometer_bias: AccelerationOffset3 = 0.0
    gyroscope_bias: AngularRateOffset3 = 0.0
    accelerometer_scale: Ratio3 = 0.0
    gyroscope_scale: Ratio3 = 0.0
    slopes: bool = eqx.field(static=True, default=False)

    @abc.abstractmethod
    def start(self) -> Any:
        """A representative initial state."""

    def rate(self, control: Any, noise: Imu) -> Float[Array, "3"]:
        """The angular rate of the body, in rad/s."""
        read = control.angular_rate - self.gyroscope_bias - noise.angular_rate
        return read / (1 + self.gyroscope_scale)

    def increments(self, control: Any, noise: Imu, dt: Scalar) -> Increments:
        r"""The increments of a step of readings.

        $\Delta v + \tfrac12 \Delta\theta \times \Delta v + \tfrac16 \Delta\theta \times
        (\Delta\theta \times \Delta v)$ is the integral of a force that is held in the body
        while it turns, to third order in the turn; its integral is the change of position.
        """
        force = control.specific_force - self.accelerometer_bias - noise.specific_force
        velocity = force / (1 + self.accelerometer_scale) * dt
        angle = self.rate(control, noise) * dt
        once = jnp.cross(angle, velocity)
        twice = jnp.cross(angle, once)
        delta_velocity = velocity + once / 2 + twice / 6
        delta_position = velocity / 2 + once / 6 + twice / 24
        if not self.slopes:
            return Increments(angle, delta_velocity, delta_position)
        rate_change = control.angular_rate_slope / (1 + self.gyroscope_scale) * dt**2
        force_change = control.specific_force_slope / (1 + self.accelerometer_scale) * dt**2
        coning = jnp.cross(angle, rate_change) / 12
        sculling = (jnp.cross(angle, force_change) + jnp.cross(velocity, rate_change)) / 12
        return Increments(
            angle + coning, delta_velocity + sculling, delta_position - force_change / 12
        )

    def noise_density(self) -> Imu:
        return Imu(jnp.full(3, self.accelerometer_noise), jnp.full(3, self.gyroscope_noise))

    def nominal_control(self, time: Scalar) -> Any:
        turn = 0.5 * jnp.sin(0.4 * time)
        force = jnp.stack([jnp.cos(0.7 * time), 5.0 * turn, jnp.full_like(turn, 9.81)])
        imu = Imu(force, jnp.stack([jnp.zeros_like(turn), jnp.zeros_like(turn), turn]))
        return ImuWithSlopes(*imu, jnp.zeros(3), jnp.zeros(3)) if self.slopes else imu


def turned(attitude: Attitude, turn: Float[Array, "3"]) -> Float[Array, "4"]:
    """An attitude after a rotation about the body's own axes."""
    after = multiply(jnp.asarray(attitude), exp(turn))
    return after / jnp.linalg.norm(after)


def in_turned_map(attitude: Attitude, frame_turn: Float[Array, "3"]) -> Float[Array, "4"]:
    """An attitude in a map that has turned by so little that the sine is the angle.

    To third order in an angle that is below 1e-3 rad in any step of a map on the earth.
    """
    back = jnp.concatenate([jnp.ones(1), -frame_turn / 2])
    return multiply(back, jnp.asarray(attitude))


def in_first_axes(
    attitude: Attitude, frame_turn: Float[Array, "3"], increments: Increments
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Changes of velocity and position on a map that turns meanwhile, in its first axes.

    Half of the turn lies before the mean change of velocity, a third before that of position.
    """
    middle = in_turned_map(attitude, frame_turn / 2)
    delta_velocity = rotate(middle, increments.delta_velocity)
    return delta_velocity, rotate(middle, increments.delta_position) + jnp.cross(
        frame_turn, delta_velocity
    ) / 12


class AbstractLocal(AbstractStrapdown):
    """On a flat map with constant gravity; with ``earth`` the map turns with the earth."""

    gravity: Acceleration = -GRAVITY[2]
    earth: bool = eqx.field(static=True, default=False)
    latitude: Radians = 0.0

    def moved(self, state: Any, control: Any, noise: Imu, dt: Scalar) -> State:
        """Position, velocity and attitude after a step."""
        increments, attitude = self.increments(control, noise, dt), jnp.asarray(state.attitude)
        fall = jnp.stack([jnp.zeros(()), jnp.zeros(()), -jnp.asarray(self.gravity) * dt])
        if self.earth:
            spin = earth_spin(self.latitude)
            delta_velocity, delta_position = in_first_axes(attitude, spin * dt, increments)
            attitude = in_turned_map(attitude, spin * dt)
            middle = state.velocity + (delta_velocity + fall) / 2
            fall = fall - 2 * jnp.cross(spin, middle) * dt
        else:
            delta_velocity = rotate(attitude, increments.delta_velocity)
            delta_position = rotate(attitude, increments.delta_position)
        return State(
            position=state.position + (state.velocity + delta_position + fall / 2) * dt,
            velocity=state.velocity + delta_velocity + fall,
            attitude=turned(attitude, increments.delta_angle),
        )


@vehicles.add("strapdown")
class Strapdown(AbstractLocal):
    r"""Position, velocity and attitude from gyroscopes and accelerometers, on a flat map.

    $\dot p = v,\ \dot v = R(q) f + g - 2 \omega_e \times v,\ \dot q = q \otimes \omega / 2 -
    \omega_e \otimes q / 2$, in steps that are exact for readings held in the body. The earth's
    rotation $\omega_e$ counts only with ``earth``: without, it is a bias of the gyroscopes that
    turns with the vehicle.

    Source: J. Solà, "Quaternion kinematics for the error-state Kalman filter", 2017,
    arXiv 1711.02508, section 5.1.
    """

    def step(self, state: State, control: Any, noise: Imu, dt: Scalar) -> State:
        return self.moved(state, control, noise, dt)

    def start(self) -> State:
        return State(jnp.zeros(3), jnp.array([5.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0, 0.0]))


@vehicles.add("strapdown-rated")
class RatedStrapdown(AbstractLocal):
    r"""The strapdown whose state knows its angular rate, for sensors on lever arms.

    All as for ``strapdown``, and $\dot\omega_s = (\omega - \omega_s) / \tau$: the rate follows
    the gyroscopes within their bandwidth. Its covariance is that of the bias and of the noise,
    so a sensor that knows the rate (a vehicle that stands) estimates the bias.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, sections 2.5.5 (lever arms) and 15.3 (zero angular rate).
    """

    rate_lag: Seconds = 0.02

    def step(self, state: RatedState, control: Any, noise: Imu, dt: Scalar) -> RatedState:
        rate = self.rate(control, noise)
        kept = jnp.exp(-dt / self.rate_lag)
        return RatedState(
            *self.moved(state, control, noise, dt),
            angular_rate=rate + (state.angular_rate - rate) * kept,
        )

    def start(self) -> RatedState:
        still = jnp.array([1.0, 0.0, 0.0, 0.0])
        return RatedState(jnp.zeros(3), jnp.array([5.0, 0.0, 0.0]), still, jnp.zeros(3))
