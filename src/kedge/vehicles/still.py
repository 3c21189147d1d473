"""Something that stays where it is, or hardly moves: a tag on a table."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import Position, Scalar, SpeedNoise, Velocity
from kedge.core.registry import vehicles


class State(NamedTuple):
    position: Position


class Control(NamedTuple):
    """Nothing: it is not driven."""


class Noise(NamedTuple):
    velocity: Velocity


@vehicles.add("still")
class Still(AbstractVehicle[State, Control, Noise]):
    r"""A point that wanders at random: $p' = p + w \Delta t$.

    Source: A. Gelb, "Applied Optimal Estimation", 1974, section 3.6 (random walk).
    """

    walk: SpeedNoise = 0.01

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        return State(state.position + noise.velocity * dt)

    def noise_density(self) -> Noise:
        return Noise(jnp.full(2, self.walk))

    def start(self) -> State:
        return State(jnp.zeros(2))

    def nominal_control(self, time: Scalar) -> Control:
        return Control()
