"""Differential drive: two driven wheels, each with its own scale and slip."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Heading,
    Metres,
    Position,
    Ratio,
    Scalar,
    Speed,
    SpeedNoise,
    YawRate,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import direction, wrap


class State(NamedTuple):
    position: Position
    heading: Heading


class Control(NamedTuple):
    left: Speed
    right: Speed


@vehicles.add("differential-drive")
class DifferentialDrive(AbstractVehicle[State, Control, Control]):
    r"""Wheel speeds drive speed and yaw rate; position is the middle of the axle.

    $v = (v_r + v_l)/2,\ \omega = (v_r - v_l)/b - b_\omega$ with $v_i = s_i u_i + w_i$, advanced
    along the exact chord of the arc. Track width b, scales and the bias $b_\omega$ can be
    estimated as augmented states.

    Source: R. Siegwart, I. Nourbakhsh, "Introduction to Autonomous Mobile Robots", 2004,
    sections 3.2 and 5.2.4.
    """

    track: Metres = 0.5
    left_scale: Ratio = 1.0
    right_scale: Ratio = 1.0
    yaw_rate_bias: YawRate = 0.0
    wheel_noise: SpeedNoise = 0.03

    def step(self, state: State, control: Control, noise: Control, dt: Scalar) -> State:
        left = (self.left_scale * control.left + noise.left) * dt
        right = (self.right_scale * control.right + noise.right) * dt
        turn = (right - left) / self.track - self.yaw_rate_bias * dt
        chord = (left + right) / 2 * jnp.sinc(turn / (2 * jnp.pi))
        return State(
            position=state.position + chord * direction(state.heading + turn / 2),
            heading=wrap(state.heading + turn),
        )

    def noise_density(self) -> Control:
        return Control(self.wheel_noise, self.wheel_noise)

    def start(self) -> State:
        return State(position=jnp.zeros(2), heading=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(left=0.8 - 0.1 * jnp.sin(0.2 * time), right=jnp.array(0.8))
