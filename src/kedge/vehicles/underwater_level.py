"""The underwater vehicle as much of the literature integrates it: always level."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    AccelerationNoise,
    AngularRate3,
    Heading,
    Position3,
    Scalar,
    Velocity3,
    YawAccelerationNoise,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import direction, wrap
from kedge.vehicles.coefficient_files import as_coefficients
from kedge.vehicles.hydrodynamics import Coefficients, features, response
from kedge.vehicles.underwater import FLIP, Control, Noise, clipped


class State(NamedTuple):
    position: Position3
    heading: Heading
    velocity_body: Velocity3
    angular_rate: AngularRate3


@vehicles.add("underwater-level")
class LevelUnderwater(AbstractVehicle[State, Control, Noise]):
    r"""All six velocities, but position and heading as if the vehicle never rolled or pitched.

    $\dot x = u \cos\psi - v \sin\psi,\ \dot y = u \sin\psi + v \cos\psi,\ \dot z = w,\
    \dot\psi = r$, and the velocities as in :mod:`kedge.vehicles.hydrodynamics`, upright. By
    Euler's rule. A torpedo dives by pitching, which this model cannot do; it is there so that
    published experiments can be repeated. For navigation use "underwater".

    Source: Ngatini et al., "Comparison of AUV position estimation using Kalman filter,
    ensemble Kalman filter and fuzzy Kalman filter algorithm in the specified trajectories",
    2022, equations 1 to 11.
    """

    coefficients: Coefficients | str = eqx.field(
        default="remus100-adjusted", converter=as_coefficients
    )
    acceleration_noise: AccelerationNoise = 0.02
    angular_noise: YawAccelerationNoise = 0.02

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        hull = as_coefficients(self.coefficients)
        velocity = FLIP * jnp.concatenate([state.velocity_body, state.angular_rate])
        down = jnp.array([0.0, 0.0, 1.0])
        push = response(hull) @ features(velocity, down, clipped(hull, control))
        return moved_level(state, FLIP * push, noise, dt)

    def noise_density(self) -> Noise:
        return Noise(jnp.full(3, self.acceleration_noise), jnp.full(3, self.angular_noise))

    def start(self) -> State:
        return _start()

    def drive(self, time: Scalar) -> Control:
        return _drive(as_coefficients(self.coefficients), time)


@vehicles.add("level-twist")
class LevelTwist(AbstractVehicle[State, Control, Noise]):
    r"""The same state without forces: velocities wander as white noise drives them.

    The kinematic baseline of "underwater-level": $\dot\nu = w$. It is told of the commands and
    does not heed them.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.2.2 (white-noise acceleration), here in the body.
    """

    acceleration_noise: AccelerationNoise = 0.02
    angular_noise: YawAccelerationNoise = 0.02

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        return moved_level(state, jnp.zeros(6), noise, dt)

    def noise_density(self) -> Noise:
        return Noise(jnp.full(3, self.acceleration_noise), jnp.full(3, self.angular_noise))

    def start(self) -> State:
        return _start()

    def drive(self, time: Scalar) -> Control:
        return _drive(as_coefficients("remus100-adjusted"), time)


def moved_level(state: State, push: Float[Array, "6"], noise: Noise, dt: Scalar) -> State:
    """One step of Euler's rule, with accelerations forward, left, up."""
    velocity = state.velocity_body
    ahead, left = direction(state.heading), direction(state.heading + jnp.pi / 2)
    plane = ahead * velocity[0] + left * velocity[1]
    return State(
        state.position + dt * jnp.append(plane, velocity[2]),
        wrap(state.heading + dt * state.angular_rate[2]),
        velocity + dt * (push[:3] + noise.acceleration),
        state.angular_rate + dt * (push[3:] + noise.angular_acceleration),
    )


def _start() -> State:
    return State(jnp.zeros(3), jnp.array(0.0), jnp.array([1.5, 0.0, 0.0]), jnp.zeros(3))


def _drive(hull: Coefficients, time: Scalar) -> Control:
    none = 0.0 * jnp.asarray(time)
    rudder = 0.05 * jnp.sin(0.5 * time)
    return Control(hull.Xprop + none, none, rudder, none)
