"""Constant velocity on the plane, disturbed by white acceleration."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import Acceleration2, AccelerationNoise, Position, Scalar, Velocity
from kedge.core.registry import vehicles


class State(NamedTuple):
    position: Position
    velocity: Velocity


class Control(NamedTuple):
    """Nothing: the vehicle is watched, not driven."""


class Noise(NamedTuple):
    acceleration: Acceleration2


@vehicles.add("constant-velocity")
class ConstantVelocity(AbstractVehicle[State, Control, Noise]):
    r"""A point that keeps its velocity, disturbed by white acceleration.

    $p' = p + v \Delta t + \tfrac12 w \Delta t^2,\quad v' = v + w \Delta t$.

    The acceleration w is held over a step and has the same power at every step length.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.3.2.
    """

    acceleration_noise: AccelerationNoise = 0.1

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        change = noise.acceleration * dt
        return State(
            position=state.position + (state.velocity + change / 2) * dt,
            velocity=state.velocity + change,
        )

    def noise_density(self) -> Noise:
        return Noise(jnp.full(2, self.acceleration_noise))

    def start(self) -> State:
        return State(position=jnp.zeros(2), velocity=jnp.array([1.0, 0.5]))

    def drive(self, time: Scalar) -> Control:
        return Control()
