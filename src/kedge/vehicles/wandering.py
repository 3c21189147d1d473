"""A walker or a cart that is led about: a velocity that is forgotten after some seconds."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Acceleration2,
    AccelerationNoise,
    Position,
    Scalar,
    Seconds,
    Velocity,
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

    $\dot p = v,\ \dot v = -v / \tau + w$, exact for an acceleration held over the step. With the
    density q of w, the velocity has the standard deviation $q \sqrt{\tau / 2}$ in each axis: a
    prior of how fast one walks, where ``constant-velocity`` has none. Without readings it
    comes to rest after $\tau v$ metres, instead of running on for ever.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 4.3.1 (the first-order Gauss-Markov process, for a velocity).
    """

    memory: Seconds = 3.0
    acceleration_noise: AccelerationNoise = 0.6

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        lasting = -self.memory * jnp.expm1(-dt / self.memory)
        push = noise.acceleration
        return State(
            position=state.position
            + lasting * state.velocity
            + self.memory * (dt - lasting) * push,
            velocity=state.velocity * jnp.exp(-dt / self.memory) + lasting * push,
        )

    def noise_density(self) -> Noise:
        return Noise(jnp.full(2, self.acceleration_noise))

    def start(self) -> State:
        return State(position=jnp.zeros(2), velocity=jnp.array([1.0, 0.5]))

    def drive(self, time: Scalar) -> Control:
        return Control()
