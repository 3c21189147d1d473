"""The underwater vehicle as much of the literature integrates it: always level."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import (
    AccelerationNoise,
    AngularRate3,
    Heading,
    Position3,
    Scalar,
    Velocity3,
    YawAccelerationNoise,
)
from kedge.core.registry import unknown, vehicles
from kedge.core.rotations import direction, wrap
from kedge.numerics.stability import RULES
from kedge.vehicles.underwater.accelerations import accelerations
from kedge.vehicles.underwater.coefficient_files import as_coefficients
from kedge.vehicles.underwater.hydrodynamics import Coefficients, response
from kedge.vehicles.underwater.underwater import (
    FLIP,
    Control,
    Noise,
    clipped,
    furthest,
    integrate,
)


class State(NamedTuple):
    position: Position3
    heading: Heading
    velocity_body: Velocity3
    angular_rate: AngularRate3


@vehicles.add("underwater-level")
class LevelUnderwater(AbstractVehicle[State, Control, Noise]):
    r"""All six velocities, but position and heading as if the vehicle never rolled or pitched.

    $\dot x = u \cos\psi - v \sin\psi,\ \dot y = u \sin\psi + v \cos\psi,\ \dot z = w,\
    \dot\psi = r$, and the velocities as in :mod:`kedge.vehicles.underwater.hydrodynamics`,
    upright. A torpedo dives by pitching, which this model cannot do; it exists so that
    published experiments can be repeated, with ``integrator`` "euler" by their rule. For
    navigation use "underwater".

    Raises:
        ContractError: an unknown integrator.
        ConfigError: the coefficients cannot be used.

    Source: Ngatini et al., "Comparison of AUV position estimation using Kalman filter,
    ensemble Kalman filter and fuzzy Kalman filter algorithm in the specified trajectories",
    2022, equations 1 to 11.
    """

    coefficients: Coefficients | str = eqx.field(
        default="remus100-adjusted", converter=as_coefficients
    )
    acceleration_noise: AccelerationNoise = 0.02
    angular_noise: YawAccelerationNoise = 0.02
    integrator: str = eqx.field(static=True, default="rk4")

    def __check_init__(self):
        if self.integrator not in RULES:
            what = unknown("integrator", self.integrator, list(RULES))
            raise ContractError(f"underwater-level: {what}")

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        hull = as_coefficients(self.coefficients)
        reply, commands = response(hull), clipped(hull, control)
        down = jnp.array([0.0, 0.0, 1.0])

        def push(velocity: Float[Array, "6"]) -> Float[Array, "6"]:
            return FLIP * accelerations(reply, FLIP * velocity, down, commands)

        return moved_level(self.integrator, push, state, noise, dt)

    def noise_density(self) -> Noise:
        return Noise(jnp.full(3, self.acceleration_noise), jnp.full(3, self.angular_noise))

    def control_limits(self) -> Control:
        """Fins turn no further than they can."""
        return furthest(as_coefficients(self.coefficients))

    def start(self) -> State:
        return _start()

    def nominal_control(self, time: Scalar) -> Control:
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
        return moved_level("rk4", jnp.zeros_like, state, noise, dt)

    def noise_density(self) -> Noise:
        return Noise(jnp.full(3, self.acceleration_noise), jnp.full(3, self.angular_noise))

    def start(self) -> State:
        return _start()

    def nominal_control(self, time: Scalar) -> Control:
        return _drive(as_coefficients("remus100-adjusted"), time)


def moved_level(
    rule: str,
    push: Callable[[Float[Array, "6"]], Float[Array, "6"]],
    state: State,
    noise: Noise,
    dt: Scalar,
) -> State:
    """One step; ``push`` gives the accelerations (forward, left, up) at a velocity."""
    shaken = jnp.concatenate([noise.acceleration, noise.angular_acceleration])

    def rates(x: Moving) -> Moving:
        """Of the six velocities, and of position and heading.

        Apart, so that it can be seen in which of them the motion is linear.
        """
        velocity, pose = x
        ahead, left = direction(pose[3]), direction(pose[3] + jnp.pi / 2)
        plane = ahead * velocity[0] + left * velocity[1]
        velocity_in_map = jnp.stack([plane[0], plane[1], velocity[2], velocity[5]])
        return push(velocity) + shaken, velocity_in_map

    twist = jnp.concatenate([state.velocity_body, state.angular_rate])
    pose = jnp.append(state.position, state.heading)
    velocity, pose = integrate(rule, rates, (twist, pose), dt)
    return State(pose[:3], wrap(pose[3]), velocity[:3], velocity[3:])


Moving = tuple[Float[Array, "6"], Float[Array, "4"]]
"""Velocities, and position with heading."""


def _start() -> State:
    return State(jnp.zeros(3), jnp.array(0.0), jnp.array([1.5, 0.0, 0.0]), jnp.zeros(3))


def _drive(hull: Coefficients, time: Scalar) -> Control:
    none = 0.0 * jnp.asarray(time)
    rudder = 0.05 * jnp.sin(0.5 * time)
    return Control(hull.Xprop + none, none, rudder, none)
