"""Ackermann steering: forklifts, tractors, cars."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    AngleNoise,
    Metres,
    Radians,
    Ratio,
    Scalar,
    Speed,
    SpeedNoise,
    SteeringAngle,
    Within,
    YawRate,
)
from kedge.core.registry import vehicles
from kedge.vehicles.arc import State, along_arc


class Control(NamedTuple):
    speed: Speed
    """Of the middle of the rear axle."""
    steering: Annotated[SteeringAngle, Within(-1.2, 1.2)]
    """Of the wheel in the middle of the front axle, to the left."""


@vehicles.add("bicycle")
class Bicycle(AbstractVehicle[State, Control, Control]):
    r"""A rear axle that drives and a front wheel that steers; its place is the rear axle.

    $\dot p = (s_v v + w_v) [\cos\psi, \sin\psi]^\top$, $\dot\psi = \frac{s_v v + w_v}{L}
    (\tan(\delta - \delta_0) + w_\delta) - b_\omega$, along the exact chord of the arc. Noise of
    the steering turns nobody who stands. A fork that steers at the rear has a negative
    wheelbase. ``steering_offset`` is what the angle's sensor reads straight ahead; wheelbase,
    offset, scale and bias can be estimated as augmented states.

    Source: S. LaValle, "Planning Algorithms", 2006, section 13.1.2.1 (a simple car).
    """

    wheelbase: Metres = 1.5
    speed_scale: Ratio = 1.0
    steering_offset: Radians = 0.0
    yaw_rate_bias: YawRate = 0.0
    speed_noise: SpeedNoise = 0.05
    steering_noise: AngleNoise = 0.02

    def step(self, state: State, control: Control, noise: Control, dt: Scalar) -> State:
        distance = (self.speed_scale * control.speed + noise.speed) * dt
        slope = jnp.tan(control.steering - self.steering_offset) + noise.steering
        turn = distance * slope / self.wheelbase - self.yaw_rate_bias * dt
        return along_arc(state, distance, 0.0, turn)

    def noise_density(self) -> Control:
        return Control(self.speed_noise, self.steering_noise)

    def start(self) -> State:
        return State(position=jnp.zeros(2), heading=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(speed=jnp.array(1.5), steering=0.3 * jnp.sin(0.2 * time))
