"""A point on the plane that is driven by its measured acceleration."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractVehicle
from kedge.core.quantities import Acceleration2, AccelerationNoise, Scalar
from kedge.core.registry import vehicles
from kedge.vehicles.constant_velocity import ContinuousNoise, State


class Control(NamedTuple):
    acceleration: Acceleration2


@vehicles.add("inertial-point")
class InertialPoint(AbstractVehicle[State, Control, ContinuousNoise]):
    r"""Inertial navigation without attitude: accelerations are measured along the map's axes.

    $p' = p + v \Delta t + \tfrac12 a \Delta t^2,\ v' = v + a \Delta t$ with the measured
    acceleration less its white noise of density N, so per axis $Q = N^2 \begin{pmatrix}
    \Delta t^3/3 & \Delta t^2/2 \\ \Delta t^2/2 & \Delta t \end{pmatrix}$. The errors of the
    four-state filters of the literature are those of this state; whether they are fed back
    (closed loop) or kept apart (open loop) makes no difference to a linear motion.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.2.2 (continuous white noise acceleration).
    """

    acceleration_noise: AccelerationNoise = 0.0039

    def step(self, state: State, control: Control, noise: ContinuousNoise, dt: Scalar) -> State:
        change = (control.acceleration - noise.acceleration) * dt
        # 1/3 = 1/4 + 1/12: what a noise that is held lacks in position, independent of it.
        apart = noise.swing * dt**2 / 12**0.5
        return State(
            position=state.position + (state.velocity + change / 2) * dt + apart,
            velocity=state.velocity + change,
        )

    def noise_density(self) -> ContinuousNoise:
        density = jnp.full(2, self.acceleration_noise)
        return ContinuousNoise(density, density)

    def start(self) -> State:
        return State(jnp.zeros(2), jnp.array([1.0, 0.5]))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(0.3 * jnp.stack([jnp.sin(0.5 * time), jnp.cos(0.5 * time)]))
