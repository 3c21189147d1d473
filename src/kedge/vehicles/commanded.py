"""A ground robot of which only the velocity commands are known, not what its wheels did."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Curvature,
    Heading,
    Metres,
    Position,
    Ratio,
    Scalar,
    Seconds,
    Speed,
    WhiteNoise,
    YawAcceleration,
    YawAccelerationNoise,
    YawRate,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import direction, wrap


class State(NamedTuple):
    position: Position
    heading: Heading
    yaw_rate: YawRate


class Control(NamedTuple):
    speed: Speed
    yaw_rate: YawRate


class Noise(NamedTuple):
    speed: WhiteNoise
    yaw_rate: WhiteNoise
    motor: YawAcceleration


@vehicles.add("commanded")
class Commanded(AbstractVehicle[State, Control, Noise]):
    r"""A unicycle whose motors follow commands with a gain, a lag and a slip.

    $\dot p = \max(s_v u_v - c |u_\omega|, 0) [\cos\psi, \sin\psi]^\top$,
    $\dot\omega = (s_\omega (u_\omega - b) + \kappa u_v - \omega) / \tau + w$,
    $\dot\psi = \omega$.
    Wheels that must turn against each other leave less speed (c); unequal ones draw an arc
    (kappa). The noise is in proportion to the motion, so a robot that stands stays where it is;
    its densities are shares of speed and yaw rate per root hertz.

    Source: S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics", 2005, section 5.3 (noise in
    proportion to the commands); J. Borenstein and L. Feng, "Measurement and correction of
    systematic odometry errors in mobile robots", IEEE Trans. Robot. Autom. 12(6), 1996.
    """

    speed_scale: Ratio = 1.0
    turn_slowdown: Metres = 0.0
    yaw_rate_scale: Ratio = 1.0
    yaw_per_metre: Curvature = 0.0
    yaw_rate_bias: YawRate = 0.0
    lag: Seconds = 0.15
    slip: Ratio = 0.2  # of the speed, into the speed
    turning_slip: Metres = 0.02  # of the yaw rate, into the speed
    yaw_slip: Ratio = 0.15  # of the yaw rate, into the yaw rate
    rolling_yaw_slip: Curvature = 0.2  # of the speed, into the yaw rate
    motor_noise: YawAccelerationNoise = 0.01

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        wanted = self.speed_scale * control.speed
        speed = jnp.maximum(wanted - self.turn_slowdown * jnp.abs(control.yaw_rate), 0.0)
        told = control.yaw_rate - self.yaw_rate_bias
        goal = self.yaw_rate_scale * told + self.yaw_per_metre * control.speed
        decay = jnp.exp(-dt / self.lag)
        rate = jnp.abs(state.yaw_rate)
        distance = (speed + (self.slip * speed + self.turning_slip * rate) * noise.speed) * dt
        spread = (self.yaw_slip * rate + self.rolling_yaw_slip * speed) * noise.yaw_rate
        turn = goal * dt + (state.yaw_rate - goal) * self.lag * (1 - decay) + spread * dt
        return State(
            position=state.position + distance * direction(state.heading + turn / 2),
            heading=wrap(state.heading + turn),
            yaw_rate=goal + (state.yaw_rate - goal) * decay + noise.motor * dt,
        )

    def noise_density(self) -> Noise:
        return Noise(jnp.array(1.0), jnp.array(1.0), jnp.asarray(self.motor_noise))

    def start(self) -> State:
        return State(jnp.zeros(2), heading=jnp.array(0.0), yaw_rate=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(speed=jnp.array(0.3), yaw_rate=0.5 * jnp.sin(0.3 * time))
