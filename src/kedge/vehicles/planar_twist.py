"""A body in the plane of which the twist is told: a mecanum base, a Doppler log."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import Ratio, Scalar, Speed, SpeedNoise, YawRate, YawRateNoise
from kedge.core.registry import vehicles
from kedge.vehicles.arc import State, along_arc


class Control(NamedTuple):
    forward: Speed
    sideways: Speed
    """To the left."""
    yaw_rate: YawRate


@vehicles.add("planar-twist")
class PlanarTwist(AbstractVehicle[State, Control, Control]):
    r"""Speed forward, speed to the left and yaw rate, each with noise and a scale.

    $\dot p = \mathrm{Rot}(\psi) [s_v v_x + w_x,\ s_v v_y + w_y]^\top$,
    $\dot\psi = s_\omega (\omega - b_\omega) + w_\omega$, exact for a twist that is held. Scales
    and the bias can be estimated as augmented states.

    With ``sampling = "increments"`` a rig drives it by ways and turns since the row before,
    with ``"poses"`` by the poses of an odometry, whose frame may drift as it likes.

    Source: K. Lynch, F. Park, "Modern Robotics", 2017, section 13.4 (odometry).
    """

    speed_scale: Ratio = 1.0
    yaw_rate_scale: Ratio = 1.0
    yaw_rate_bias: YawRate = 0.0
    forward_noise: SpeedNoise = 0.05
    sideways_noise: SpeedNoise = 0.05
    yaw_rate_noise: YawRateNoise = 0.02

    def step(self, state: State, control: Control, noise: Control, dt: Scalar) -> State:
        rate = self.yaw_rate_scale * (control.yaw_rate - self.yaw_rate_bias) + noise.yaw_rate
        forward = self.speed_scale * control.forward + noise.forward
        sideways = self.speed_scale * control.sideways + noise.sideways
        return along_arc(state, forward * dt, sideways * dt, rate * dt)

    def noise_density(self) -> Control:
        return Control(self.forward_noise, self.sideways_noise, self.yaw_rate_noise)

    def start(self) -> State:
        return State(position=jnp.zeros(2), heading=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        turning = 0.3 * jnp.sin(0.2 * time)
        return Control(jnp.array(0.8), 0.2 * jnp.cos(0.3 * time), turning)
