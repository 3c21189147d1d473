"""Four omnidirectional wheels: the body moves in any direction, whatever its heading."""

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import (
    Heading,
    Metres,
    Position,
    Scalar,
    SpeedNoise,
    Velocity,
    WheelRateNoise,
    WheelRates,
    YawRate,
    YawRateNoise,
)
from kedge.core.registry import unknown, vehicles
from kedge.core.rotations import direction, wrap

RULES = {"forward": 0.0, "midpoint": 0.5, "backward": 1.0}
"""Share of the turn at whose end the body's velocity is turned into the map."""
KINEMATICS: list[str] = ["physical", "mirrored"]


class State(NamedTuple):
    position: Position
    heading: Heading


class Control(NamedTuple):
    wheels: WheelRates


class Noise(NamedTuple):
    wheels: WheelRates
    velocity: Velocity
    yaw_rate: YawRate


class Twist(NamedTuple):
    """Velocity of the body, in its own frame."""

    velocity: Velocity
    yaw_rate: YawRate


@vehicles.add("omnidirectional")
class Omnidirectional(AbstractVehicle[State, Control, Noise]):
    r"""Wheels at the angles $\alpha_i$ around the body; a positive spin turns it to the left.

    Inverse kinematics $\dot\varphi = J \nu$ with rows
    $J_i = \tfrac1r [-\sin\alpha_i, \cos\alpha_i, R]$ and the body's twist
    $\nu = [v_x, v_y, \omega]$; forward $\nu = J^+ \dot\varphi$ with the pseudoinverse. Then
    $\theta' = \theta + (\omega - b_\omega) \Delta t$ and
    $p' = p + \mathrm{Rot}(\theta + \gamma \omega \Delta t)\, v \Delta t$, with
    $\gamma = 0, \tfrac12, 1$ by ``rule`` forward, midpoint or backward.

    Noise enters at the wheels (through $J^+$), and as a velocity in the map and a yaw rate,
    which stand for slip. ``kinematics`` "mirrored" is the matrix as the paper prints it, in
    which the heading has the wrong sign: right only in a world that makes the same mistake.

    Source: K. Lynch, F. Park, "Modern Robotics", 2017, section 13.2 (omnidirectional wheels).
    """

    radius: Metres = 0.05
    arm: Metres = 0.20
    yaw_rate_bias: YawRate = 0.0
    wheel_noise: WheelRateNoise = 0.014
    slip_noise: SpeedNoise = 0.01
    turn_noise: YawRateNoise = 0.0173
    angles: tuple[float, ...] = eqx.field(
        static=True, default=(0.0, math.pi / 2, math.pi, 3 * math.pi / 2)
    )
    rule: str = eqx.field(static=True, default="midpoint")
    kinematics: str = eqx.field(static=True, default="physical")

    def __check_init__(self):
        for name, word, known in (
            ("rule", self.rule, list(RULES)),
            ("kinematics", self.kinematics, KINEMATICS),
        ):
            if word not in known:
                raise ContractError(f"omnidirectional: {unknown(name, word, known)}")
        if len(self.angles) != 4:
            raise ContractError(
                f"omnidirectional: angles has {len(self.angles)} entries, expected one for "
                "each of 4 wheels, in rad"
            )
        if np.linalg.matrix_rank(_directions(self.angles), tol=1e-9) < 3:
            raise ContractError(
                f"omnidirectional: wheels at {self.angles} rad cannot move the body in every "
                "direction; expected at least three different angles"
            )

    def wheel_rates(self, twist: Twist) -> WheelRates:
        """Inverse kinematics: the wheel rates that give a twist of the body."""
        rows = jnp.asarray(_directions(self.angles)) * jnp.stack([1.0, 1.0, self.arm])[None]
        return (
            rows
            @ jnp.concatenate([twist.velocity, jnp.asarray(twist.yaw_rate)[None]])
            / self.radius
        )

    def twist(self, wheels: WheelRates) -> Twist:
        """Forward kinematics: the twist that fits the wheel rates best."""
        inverse = jnp.asarray(np.linalg.pinv(_directions(self.angles)))
        velocity = self.radius * (inverse @ wheels)
        return Twist(velocity[:2], velocity[2] / self.arm)

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        twist = self.twist(control.wheels + noise.wheels)
        turn = (twist.yaw_rate - self.yaw_rate_bias) * dt
        at = state.heading + RULES[self.rule] * turn
        if self.kinematics == "mirrored":
            at = -at
        ahead, left = direction(at), direction(at + jnp.pi / 2)
        velocity = ahead * twist.velocity[0] + left * twist.velocity[1]
        return State(
            position=state.position + (velocity + noise.velocity) * dt,
            heading=wrap(state.heading + turn + noise.yaw_rate * dt),
        )

    def noise_density(self) -> Noise:
        return Noise(
            wheels=jnp.full(4, self.wheel_noise),
            velocity=jnp.full(2, self.slip_noise),
            yaw_rate=jnp.asarray(self.turn_noise),
        )

    def start(self) -> State:
        return State(position=jnp.zeros(2), heading=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        turning = Twist(jnp.array([0.0, -0.157]), 0.157 + 0.0 * jnp.asarray(time))
        return Control(self.wheel_rates(turning))


def _directions(angles: tuple[float, ...]) -> Float[np.ndarray, "4 3"]:
    """Rows of J for a unit radius and a unit arm."""
    at = np.asarray(angles)
    return np.column_stack([-np.sin(at), np.cos(at), np.ones_like(at)])
