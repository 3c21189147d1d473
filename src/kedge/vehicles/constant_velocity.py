"""Constant velocity on the plane, disturbed by white acceleration: three ways to mean that."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import (
    Acceleration,
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
        return _held(state, noise.acceleration, dt)

    def noise_density(self) -> Noise:
        return Noise(jnp.full(2, self.acceleration_noise))

    def start(self) -> State:
        return _start()

    def nominal_control(self, time: Scalar) -> Control:
        return Control()


@vehicles.add("discrete-white-acceleration")
class DiscreteWhiteAcceleration(AbstractVehicle[State, Control, Noise]):
    r"""Constant velocity, with an acceleration drawn anew every ``period``.

    $x' = F x + G w$, $G = [\tfrac12 \Delta t^2, \Delta t]$, $w \sim N(0, \sigma_a^2)$, so
    $Q = \sigma_a^2 G G^\top$, of rank two in the plane, at steps of one period. At steps of
    another length the power is kept, $\sigma_a^2\,T / \Delta t$: it is ``constant-velocity``
    with the density $\sigma_a \sqrt{T}$.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.3.2 (discrete white noise acceleration).
    """

    acceleration_std: Acceleration = 0.1
    period: Seconds = 0.1

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        return _held(state, noise.acceleration, dt)

    def noise_density(self) -> Noise:
        return Noise(jnp.full(2, self.acceleration_std * jnp.sqrt(self.period)))

    def start(self) -> State:
        return _start()

    def nominal_control(self, time: Scalar) -> Control:
        return Control()


class ContinuousNoise(NamedTuple):
    acceleration: Acceleration2
    """Mean over the step."""
    swing: Acceleration2
    """What the acceleration does within the step without changing its mean."""


@vehicles.add("continuous-white-acceleration")
class ContinuousWhiteAcceleration(AbstractVehicle[State, Control, ContinuousNoise]):
    r"""Constant velocity, with an acceleration that is white in continuous time.

    Per axis $Q = q \begin{pmatrix} \Delta t^3/3 & \Delta t^2/2 \\ \Delta t^2/2 & \Delta t
    \end{pmatrix}$ with the spectral density $q$ = ``acceleration_noise`` squared: the same
    however time is cut into steps, which no held acceleration gives to all orders.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.2.2 (continuous white noise acceleration).
    """

    acceleration_noise: AccelerationNoise = 0.1

    def step(self, state: State, control: Control, noise: ContinuousNoise, dt: Scalar) -> State:
        held = _held(state, noise.acceleration, dt)
        # 1/3 = 1/4 + 1/12: what is missing in the held one's position, independent of it.
        return held._replace(position=held.position + noise.swing * dt**2 / 12**0.5)

    def noise_density(self) -> ContinuousNoise:
        density = jnp.full(2, self.acceleration_noise)
        return ContinuousNoise(density, density)

    def start(self) -> State:
        return _start()

    def nominal_control(self, time: Scalar) -> Control:
        return Control()


def _held(state: State, acceleration: Acceleration2, dt: Scalar) -> State:
    change = acceleration * dt
    return State(
        position=state.position + (state.velocity + change / 2) * dt,
        velocity=state.velocity + change,
    )


def _start() -> State:
    return State(position=jnp.zeros(2), velocity=jnp.array([1.0, 0.5]))
