"""A vehicle on a level floor that follows its route, and the readings of the IMU on it."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Key, PRNGKeyArray

from kedge.core.quantities import (
    Acceleration,
    Acceleration3,
    AngularRate3,
    Attitude,
    Metres,
    Position3,
    Ratio,
    Seconds,
    Velocity3,
)
from kedge.core.registry import worlds
from kedge.core.rotations import conjugate, log, multiply, rotate
from kedge.simulation.imu import errors, preset
from kedge.simulation.routes import AbstractRoute
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.vehicles.strapdown import Imu


class State(NamedTuple):
    """The motion, and the errors of the sensors that a rig may estimate with it."""

    position: Position3
    velocity: Velocity3
    attitude: Attitude
    angular_rate: AngularRate3
    accelerometer_bias: Acceleration3
    gyroscope_bias: AngularRate3
    odometer_scale: Ratio


@worlds.add("measured-vehicle")
class MeasuredVehicle(AbstractWorld):
    r"""The truth is the route at a height; the control is what an IMU reads of it.

    True readings are the means over a step that turn one pose and velocity into the next:
    $\Delta\theta = \log(q_k^{-1} q_{k+1})$ and $J(\Delta\theta)^{-1} R_k^\top (v_{k+1} - v_k -
    g \Delta t)$ with the left Jacobian J of a turn, to third order. So integrating them gives
    the route back. On top come the errors of an IMU by its name.

    Source: P. Savage, "Strapdown inertial navigation integration algorithm design", J. Guid.
    Control Dyn. 21(1) and 21(2), 1998.
    """

    route: AbstractRoute
    imu: str = eqx.field(static=True, default="mpu6050")
    height: Metres = 0.0
    gravity: Acceleration = 9.81
    delay: Seconds = 0.0
    """How long it stands at the route's beginning before it sets out."""
    odometer_scale_std: Ratio = 0.0
    instability: bool = eqx.field(static=True, default=True)
    """Whether the biases flicker, of which no filter with white noise and walks knows."""

    def __check_init__(self):
        preset(self.imu)

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        del sensing
        dt, steps = scenario.dt, scenario.steps
        imu_key, scale_key = jr.split(key)
        motion = self.motion(jnp.arange(steps + 1) * dt)
        true = self.readings(*motion, dt)
        wrong = errors(preset(self.imu), steps, dt, imu_key, self.instability)
        reported = Imu(
            true.specific_force + wrong.specific_force, true.angular_rate + wrong.angular_rate
        )
        position, velocity, attitude = motion
        scale = 1 + self.odometer_scale_std * jr.normal(scale_key)
        path = State(
            position[1:],
            velocity[1:],
            attitude[1:],
            true.angular_rate,
            wrong.accelerometer_bias,
            wrong.gyroscope_bias,
            jnp.full(steps, scale),
        )
        start = jax.tree.map(lambda leaf: leaf[0], path)
        first = start._replace(position=position[0], velocity=velocity[0], attitude=attitude[0])
        return History(path, reported, first)

    def motion(self, time: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and attitude at some times."""
        places = jax.vmap(self.route.at)(jnp.maximum(time - self.delay, 0.0))
        speed = jnp.where((time >= self.delay)[:, None], places.velocity, 0.0)
        flat, half = jnp.zeros(len(time)), places.heading / 2
        level = jnp.full(len(time), jnp.asarray(self.height, float))
        position = jnp.concatenate([places.position, level[:, None]], axis=1)
        velocity = jnp.concatenate([speed, flat[:, None]], axis=1)
        return position, velocity, jnp.stack([jnp.cos(half), flat, flat, jnp.sin(half)], axis=1)

    def readings(self, position: Array, velocity: Array, attitude: Array, dt: float) -> Imu:
        """What a perfect IMU reads in the mean over each step."""
        del position
        up = jnp.array([0.0, 0.0, 1.0]) * self.gravity

        def one(before: Array, after: Array, change: Array) -> Imu:
            turn = log(multiply(conjugate(before), after))
            pushed = rotate(conjugate(before), change + up * dt)
            twist = jnp.cross(turn, pushed)
            push = pushed - twist / 2 + jnp.cross(turn, twist) / 12
            return Imu(push / dt, turn / dt)

        return jax.vmap(one)(attitude[:-1], attitude[1:], jnp.diff(velocity, axis=0))
