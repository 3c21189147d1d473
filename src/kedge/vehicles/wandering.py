"""A walker or a cart that is led about: a velocity that is forgotten after some seconds."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Acceleration2,
    Acceleration3,
    AccelerationNoise,
    Position,
    Position3,
    Scalar,
    Seconds,
    Velocity,
    Velocity3,
)
from kedge.core.registry import vehicles


class State(NamedTuple):
    position: Position
    velocity: Velocity


class Control(NamedTuple):
    """Nothing: the walker is watched, not driven."""


class Noise(NamedTuple):
    acceleration: Acceleration2


@vehicles.add("wandering")
class Wandering(AbstractVehicle[State, Control, Noise]):
    r"""A velocity that decays with the time constant ``memory`` and is stirred by white noise.

    $\dot p = v,\ \dot v = -v / \tau + w$, exact for an acceleration held over the step. With
    the density q of w, the velocity has the standard deviation $q \sqrt{\tau / 2}$ in each
    axis: a prior of how fast one walks, where ``constant-velocity`` has none. Without readings
    it comes to rest after $\tau v$ metres, instead of running on for ever.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 4.3.1 (the first-order Gauss-Markov process, for a velocity).
    """

    memory: Seconds = 3.0
    acceleration_noise: AccelerationNoise = 0.6

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        return State(*_moved(state, noise, self.memory, dt))

    def noise_density(self) -> Noise:
        return Noise(jnp.full(2, self.acceleration_noise))

    def start(self) -> State:
        return State(position=jnp.zeros(2), velocity=jnp.array([1.0, 0.5]))

    def nominal_control(self, time: Scalar) -> Control:
        return Control()


class State3(NamedTuple):
    position: Position3
    velocity: Velocity3


class Noise3(NamedTuple):
    acceleration: Acceleration3


@vehicles.add("wandering3")
class Wandering3(AbstractVehicle[State3, Control, Noise3]):
    r"""``wandering`` in space, with a noise of its own for the vertical: one walks on a floor.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 4.3.1 (the first-order Gauss-Markov process, for a velocity).
    """

    memory: Seconds = 2.0
    acceleration_noise: AccelerationNoise = 0.7
    vertical_noise: AccelerationNoise = 0.3

    def step(self, state: State3, control: Control, noise: Noise3, dt: Scalar) -> State3:
        return State3(*_moved(state, noise, self.memory, dt))

    def noise_density(self) -> Noise3:
        level = jnp.asarray(self.acceleration_noise)
        return Noise3(jnp.stack([level, level, jnp.asarray(self.vertical_noise)]))

    def start(self) -> State3:
        return State3(position=jnp.zeros(3), velocity=jnp.array([1.0, 0.5, 0.0]))

    def nominal_control(self, time: Scalar) -> Control:
        return Control()


def _moved(state: Any, noise: Any, memory: Scalar, dt: Scalar) -> tuple[Array, Array]:
    """Position and velocity after a step."""
    lasting = -memory * jnp.expm1(-dt / memory)
    push = noise.acceleration
    position = state.position + lasting * state.velocity + memory * (dt - lasting) * push
    return position, state.velocity * jnp.exp(-dt / memory) + lasting * push
