"""Kinematic unicycle: the planar robot of the localisation textbooks."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Heading,
    Position,
    Ratio,
    Scalar,
    Speed,
    SpeedNoise,
    YawRate,
    YawRateNoise,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import direction, wrap


class State(NamedTuple):
    position: Position
    heading: Heading


class Control(NamedTuple):
    speed: Speed
    yaw_rate: YawRate


@vehicles.add("unicycle")
class Unicycle(AbstractVehicle[State, Control, Control]):
    r"""Noisy odometry on the plane.

    $\dot p = (s_v v + w_v) [\cos\psi, \sin\psi]^\top$,
    $\dot\psi = s_\omega (\omega - b_\omega) + w_\omega$, advanced along the exact chord of the
    arc. Scales and the bias of a gyroscope can be estimated as augmented states.

    Source: S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics", 2005, section 5.3.
    """

    speed_scale: Ratio = 1.0
    yaw_rate_scale: Ratio = 1.0
    yaw_rate_bias: YawRate = 0.0
    speed_noise: SpeedNoise = 0.1
    yaw_rate_noise: YawRateNoise = 0.02

    def step(self, state: State, control: Control, noise: Control, dt: Scalar) -> State:
        distance = (self.speed_scale * control.speed + noise.speed) * dt
        rate = self.yaw_rate_scale * (control.yaw_rate - self.yaw_rate_bias)
        turn = (rate + noise.yaw_rate) * dt
        chord = distance * jnp.sinc(turn / (2 * jnp.pi))
        return State(
            position=state.position + chord * direction(state.heading + turn / 2),
            heading=wrap(state.heading + turn),
        )

    def noise_density(self) -> Control:
        return Control(self.speed_noise, self.yaw_rate_noise)

    def start(self) -> State:
        return State(position=jnp.zeros(2), heading=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(speed=jnp.array(5.0), yaw_rate=0.3 * jnp.sin(0.2 * time))
