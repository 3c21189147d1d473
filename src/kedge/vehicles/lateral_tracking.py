"""A car's deviation from a path that it follows at constant speed: the lateral dynamics."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.manifolds import space
from kedge.core.quantities import (
    Acceleration,
    AccelerationNoise,
    Curvature,
    Inertia,
    Kilograms,
    Metres,
    Radians,
    Scalar,
    Speed,
    SteeringAngle,
    Stiffness,
    YawAcceleration,
    YawAccelerationNoise,
    YawRate,
)
from kedge.core.registry import vehicles
from kedge.numerics.exponential import held_inputs


class State(NamedTuple):
    lateral_velocity: Speed
    yaw_rate: YawRate
    offset: Metres
    """Distance from the path, positive to the left."""
    heading_error: Radians
    """Against the path; the model is one of small angles, which are not wrapped."""
    speed_error: Speed
    """Speed beyond the one that the model is written for."""


class Control(NamedTuple):
    steering: SteeringAngle
    acceleration: Acceleration
    curvature: Curvature
    """Of the path, known beforehand."""


class Noise(NamedTuple):
    lateral: Acceleration
    yaw: YawAcceleration
    longitudinal: Acceleration


class AbstractLateral(AbstractVehicle[State, Control, Noise]):
    """The car: linear tyres, whose stiffnesses are those of an axle, both wheels together."""

    speed: Speed = 40.0
    mass: Kilograms = 1500.0
    inertia: Inertia = 2500.0
    front_stiffness: Stiffness = 55_000.0
    rear_stiffness: Stiffness = 65_000.0
    front_arm: Metres = 1.1
    rear_arm: Metres = 1.6
    lateral_noise: AccelerationNoise = 0.0707
    yaw_noise: YawAccelerationNoise = 0.0283
    longitudinal_noise: AccelerationNoise = 0.0424

    def tyres(self) -> Float[Array, "2 3"]:
        r"""Rows $\dot v_y$ and $\dot r$ by $v_y$, $r$ and the steering angle $\delta$."""
        front, rear = self.front_stiffness, self.rear_stiffness
        moment = self.front_arm * front - self.rear_arm * rear
        second = self.front_arm**2 * front + self.rear_arm**2 * rear
        m, spin = self.mass * self.speed, self.inertia * self.speed
        rows = (
            (-(front + rear) / m, -moment / m - self.speed, front / self.mass),
            (-moment / spin, -second / spin, self.front_arm * front / self.inertia),
        )
        return jnp.stack([jnp.stack([jnp.asarray(entry) for entry in row]) for row in rows])

    def noise_density(self) -> Noise:
        densities = self.lateral_noise, self.yaw_noise, self.longitudinal_noise
        return Noise(*map(jnp.asarray, densities))

    def start(self) -> State:
        return State(*map(jnp.asarray, (0.0, 0.0, 1.0, 0.0, 0.0)))

    def nominal_control(self, time: Scalar) -> Control:
        none = 0.0 * jnp.asarray(time)
        return Control(0.01 * jnp.sin(0.5 * time), none, none)


@vehicles.add("lateral-tracking")
class LateralTracking(AbstractLateral):
    r"""Deviation of a car from its path: offset, heading, speed, and the motion behind them.

    $\dot v_y = -\tfrac{C_f + C_r}{m v_x} v_y - \bigl(\tfrac{l_f C_f - l_r C_r}{m v_x} +
    v_x\bigr) r + \tfrac{C_f}{m} \delta$,
    $\dot r = -\tfrac{l_f C_f - l_r C_r}{I_z v_x} v_y - \tfrac{l_f^2 C_f + l_r^2 C_r}{I_z v_x} r
    + \tfrac{l_f C_f}{I_z} \delta$,
    $\dot e_y = v_y \cos e_\varphi + v_x \sin e_\varphi$, $\dot e_\varphi = r - \kappa v_x$,
    $\dot e_v = r v_y + a_x$, with the speed $v_x$ held. One Runge-Kutta step of fourth order;
    at walking pace the tyres are stiff, and steps must be short: below 0.015 s at 0.6 m/s.

    Source: R. Rajamani, "Vehicle Dynamics and Control", 2nd ed., 2012, sections 2.3 and 2.5.
    """

    def rates(
        self, state: Float[Array, "5"], control: Control, noise: Noise
    ) -> Float[Array, "5"]:
        """Time derivatives, in the order of the fields."""
        lateral, yaw, _, heading, _ = state
        slip, spin = self.tyres() @ jnp.stack([lateral, yaw, jnp.asarray(control.steering)])
        return jnp.stack(
            [
                slip + noise.lateral,
                spin + noise.yaw,
                lateral * jnp.cos(heading) + self.speed * jnp.sin(heading),
                yaw - control.curvature * self.speed,
                yaw * lateral + control.acceleration + noise.longitudinal,
            ]
        )

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        states = space(state)
        x = jnp.stack([jnp.asarray(field) for field in state])
        k1 = self.rates(x, control, noise)
        k2 = self.rates(x + dt / 2 * k1, control, noise)
        k3 = self.rates(x + dt / 2 * k2, control, noise)
        k4 = self.rates(x + dt * k3, control, noise)
        return states.boxplus(state, dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4))


@vehicles.add("lateral-tracking-linear")
class LinearLateralTracking(AbstractLateral):
    r"""``lateral-tracking`` linearised on the path: $\dot x = A x + B u$, inputs held.

    $\dot e_y = v_y + v_x e_\varphi$ and $\dot e_v = a_x$, the rest as it is. Discretised
    exactly for inputs that are held over the step,
    $\exp \begin{pmatrix} A & B \\ 0 & 0 \end{pmatrix} \Delta t$: Euler's rule would be
    unstable from 0.2 s on at 40 m/s, and from 0.011 s at 0.6 m/s.

    Source: R. Rajamani, "Vehicle Dynamics and Control", 2nd ed., 2012, section 2.5; C. Van
    Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic
    Control 23(3), 1978.
    """

    def system(self) -> tuple[Float[Array, "5 5"], Float[Array, "5 5"]]:
        """A, and B by steering, curvature and the three accelerations of the noise."""
        tyres, speed = self.tyres(), jnp.asarray(self.speed)
        A = jnp.zeros((5, 5)).at[:2, :2].set(tyres[:, :2])
        A = A.at[2, 0].set(1.0).at[2, 3].set(speed).at[3, 1].set(1.0)
        B = jnp.zeros((5, 5)).at[:2, 0].set(tyres[:, 2]).at[3, 1].set(-speed)
        return A, B.at[0, 2].set(1.0).at[1, 3].set(1.0).at[4, 4].set(1.0)

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        F, G = held_inputs(*self.system(), dt)
        x = jnp.stack([jnp.asarray(field) for field in state])
        push = control.acceleration + noise.longitudinal
        inputs = (control.steering, control.curvature, noise.lateral, noise.yaw, push)
        u = jnp.stack([jnp.asarray(value) for value in inputs])
        return space(state).unflatten(F @ x + G @ u)
