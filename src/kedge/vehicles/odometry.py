"""Wheel encoders: two wheels whose ticks are counted."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.manifolds import Euclidean
from kedge.core.quantities import Metres, Ratio, Scalar, SpeedNoise, WhiteNoise, YawRate
from kedge.core.registry import vehicles
from kedge.vehicles.arc import State, along_arc

TickRate = Annotated[Scalar, Euclidean("1/s")]


class Control(NamedTuple):
    left: TickRate
    right: TickRate


class Noise(NamedTuple):
    left: WhiteNoise
    right: WhiteNoise


@vehicles.add("odometry")
class Odometry(AbstractVehicle[State, Control, Noise]):
    r"""Ticks a second of two wheels drive the middle of their axle.

    $v_i = m_i u_i + (\sigma + s |m_i u_i|) w_i$, $v = (v_r + v_l)/2$,
    $\omega = (v_r - v_l)/b - b_\omega$, along the exact chord of the arc. A wheel that slips
    does so in proportion to its speed (s, ``slip``); ticks' lengths and track can be estimated.

    In a log the columns are counts, with the control's ``sampling = "counts"``; a counter of 16
    bits that flows over says ``counter = 65536``.

    Source: R. Siegwart, I. Nourbakhsh, "Introduction to Autonomous Mobile Robots", 2004,
    section 5.2.4 (odometric position estimation).
    """

    left_metres_per_tick: Metres = 0.001
    right_metres_per_tick: Metres = 0.001
    track: Metres = 0.5
    yaw_rate_bias: YawRate = 0.0
    wheel_noise: SpeedNoise = 0.005
    slip: Ratio = 0.05

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        left = self._way(self.left_metres_per_tick * control.left, noise.left, dt)
        right = self._way(self.right_metres_per_tick * control.right, noise.right, dt)
        turn = (right - left) / self.track - self.yaw_rate_bias * dt
        return along_arc(state, (left + right) / 2, 0.0, turn)

    def _way(self, speed: Scalar, noise: Scalar, dt: Scalar) -> Scalar:
        return (speed + (self.wheel_noise + self.slip * jnp.abs(speed)) * noise) * dt

    def noise_density(self) -> Noise:
        return Noise(jnp.array(1.0), jnp.array(1.0))

    def start(self) -> State:
        return State(position=jnp.zeros(2), heading=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(left=800.0 - 100 * jnp.sin(0.2 * time), right=jnp.array(800.0))
