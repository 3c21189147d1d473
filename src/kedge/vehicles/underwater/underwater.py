"""A torpedo-shaped underwater vehicle in six degrees of freedom."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import (
    Acceleration3,
    AccelerationNoise,
    AngularAcceleration3,
    Force,
    Radians,
    Ratio,
    Scalar,
    Torque,
    Velocity3,
    YawAccelerationNoise,
)
from kedge.core.registry import unknown, vehicles
from kedge.core.rotations import conjugate, matrix_of, rotate, spun
from kedge.numerics.stability import RULES, longest_step
from kedge.vehicles.body_twist import State as State
from kedge.vehicles.underwater.accelerations import accelerations
from kedge.vehicles.underwater.coefficient_files import as_coefficients
from kedge.vehicles.underwater.hydrodynamics import (
    FORCES,
    Coefficients,
    cruise,
    modes,
    response,
    tangent_features,
)

P = TypeVar("P")


class Control(NamedTuple):
    thrust: Force
    roll_torque: Torque
    """Of the propeller, on the body; positive rolls it to the right (starboard down)."""
    rudder: Radians
    """Positive turns to port (to the left)."""
    stern: Radians
    """Positive makes the vehicle dive."""


class Noise(NamedTuple):
    acceleration: Acceleration3
    angular_acceleration: AngularAcceleration3


@vehicles.add("underwater")
class Underwater(AbstractVehicle[State, Control, Noise]):
    r"""Rigid body, added mass, drag, lift, fins, propeller, weight and buoyancy.

    $M \dot\nu = F(\nu, \eta, u)$ with the equations of
    :func:`kedge.vehicles.underwater.hydrodynamics.terms` through the water, which moves with
    ``current`` (east, north, up): $\dot p = R(q) \nu + c$. Attitude is a quaternion, so no
    angle is singular. The noise is an acceleration, not a force.

    ``coefficients`` names a set that comes with kedge or a TOML file of your own. Fins turn to
    the set's ``fin_limit`` at most; commands beyond it are clipped. ``integrator`` "euler" is
    the rule of much of the literature, and makes the undamped roll grow; "rk4" is of fourth
    order. With ``linear`` forces and moments are linearised about straight and level travel at
    the cruise of ``Xprop``, as much of the literature has it; position and attitude follow
    exactly. ``thrust_scale``, ``drag_scale`` (axial), ``current`` and ``trim_moment`` can be
    estimated as augmented states; the last is a pitching moment, nose up positive, that no
    coefficient explains: ballast that lies elsewhere than said, lift and fins not as said.

    The REMUS hull is unstable in yaw and pitch without a pilot.

    Raises:
        ContractError: an unknown integrator.
        ConfigError: the coefficients cannot be used.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, chapters 2 to 6; T. Fossen, "Handbook of Marine
    Craft Hydrodynamics and Motion Control", 2011, section 8.3 (current).
    """

    coefficients: Coefficients | str = eqx.field(
        default="remus100-adjusted", converter=as_coefficients
    )
    thrust_scale: Ratio = 1.0
    drag_scale: Ratio = 1.0
    trim_moment: Torque = 0.0
    current: Velocity3 = eqx.field(default=(0.0, 0.0, 0.0), converter=jnp.asarray)
    acceleration_noise: AccelerationNoise = 0.02
    angular_noise: YawAccelerationNoise = 0.02
    integrator: str = eqx.field(static=True, default="rk4")
    linear: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if self.integrator not in RULES:
            what = unknown("integrator", self.integrator, list(RULES))
            raise ContractError(f"underwater: {what}")
        if np.shape(self.current) != (3,):
            raise ContractError(
                f"underwater: current has the shape {np.shape(self.current)}, expected 3 "
                "components: east, north, up (m/s)"
            )

    @property
    def hull(self) -> Coefficients:
        """The coefficients."""
        return as_coefficients(self.coefficients)

    def step(self, state: State, control: Control, noise: Noise, dt: Scalar) -> State:
        pushed = self._pushed(control)
        shaken = jnp.concatenate(
            [FLIP[:3] * noise.acceleration, FLIP[3:] * noise.angular_acceleration]
        )
        current = jnp.asarray(self.current)

        def rates(x: Float[Array, "13"]) -> Float[Array, "13"]:
            """Of u to r (forward, starboard, down), the position and the quaternion."""
            velocity, quaternion = x[:6], x[9:]
            turn = matrix_of(quaternion)
            push = pushed(velocity, turn) + shaken
            velocity_in_map = jnp.sum(turn * (FLIP[:3] * velocity[:3])[None], axis=1) + current
            return jnp.concatenate(
                [push, velocity_in_map, spun(quaternion, FLIP[3:] * velocity[3:])]
            )

        x = jnp.concatenate([self._through(state), state.position, state.attitude])
        x = integrate(self.integrator, rates, x, dt)
        attitude = x[9:] / jnp.sqrt(x[9:] @ x[9:])
        velocity = FLIP * x[:6]
        drift = rotate(conjugate(attitude), current)
        return State(x[6:9], attitude, velocity[:3] + drift, velocity[3:])

    def accelerations(self, state: State, control: Control) -> Float[Array, "6"]:
        """Those of u, v, w, p, q, r (forward, starboard, down) through the water."""
        return self._pushed(control)(self._through(state), matrix_of(state.attitude))

    def _through(self, state: State) -> Float[Array, "6"]:
        """The velocities through the water, forward, starboard, down."""
        drift = rotate(conjugate(state.attitude), jnp.asarray(self.current))
        return FLIP * jnp.concatenate([state.velocity_body - drift, state.angular_rate])

    def _pushed(self, control: Control) -> Callable[[Array, Array], Float[Array, "6"]]:
        """The accelerations by velocities and the rotation of the map from the body."""
        hull, pushed = self.hull, accelerations
        reply = response(hull, self.drag_scale)
        if self.linear:
            pushed = _linear(hull)
        commands = clipped(hull, control, self.thrust_scale)
        pitching = self.trim_moment * hull.compliance()[:, PITCH]
        return lambda v, turn: pushed(reply, v, DOWN * turn[2], commands) + pitching

    def noise_density(self) -> Noise:
        return Noise(jnp.full(3, self.acceleration_noise), jnp.full(3, self.angular_noise))

    def longest_step(self) -> float:
        """From the modes at rest and in a straight cruise."""
        hull = self.hull
        eigenvalues = [modes(hull, speed) for speed in (0.0, cruise(hull))]
        return longest_step(self.integrator, np.concatenate(eigenvalues))

    def control_limits(self) -> Control:
        """Fins turn no further than they can."""
        return furthest(self.hull)

    def start(self) -> State:
        none = jnp.zeros(3)
        return State(none, jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.array([1.5, 0.0, 0.0]), none)

    def nominal_control(self, time: Scalar) -> Control:
        hull, none = self.hull, 0.0 * jnp.asarray(time)
        fins = 0.05 * jnp.sin(0.5 * time), 0.05 * jnp.cos(0.3 * time)
        return Control(hull.Xprop + none, hull.Kprop + none, *fins)


PITCH = FORCES.index("pitch")
FLIP: Any = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
"""From forward, left, up to forward, starboard, down, and back."""
DOWN: Any = np.array([-1.0, 1.0, 1.0])
"""From the map's up in the body (forward, left, up) to gravity's direction there (forward,
starboard, down)."""


def clipped(
    hull: Coefficients, control: Control, thrust_scale: Scalar = 1.0
) -> Float[Array, "4"]:
    """The commands as they act: propulsion as scaled, and fins as far as they turn."""
    parts = [thrust_scale * control.thrust, thrust_scale * control.roll_torque]
    limit = hull.fin_limit
    parts += [jnp.clip(fin, -limit, limit) for fin in (control.rudder, control.stern)]
    return jnp.stack([jnp.asarray(part) for part in parts])


def furthest(hull: Coefficients) -> Control:
    """The commands beyond which :func:`clipped` cuts."""
    return Control(math.inf, math.inf, hull.fin_limit, hull.fin_limit)


def _linear(hull: Coefficients) -> Callable[..., Float[Array, "6"]]:
    """The accelerations with features to first order."""
    form = tangent_features(hull)
    return lambda reply, *given: reply @ form(*given)


def integrate(rule: str, rates: Callable[[P], P], x: P, dt: Scalar) -> P:
    """One step of the classical fourth-order rule, or of Euler's.

    x is an array, or a tuple of them.

    Source: E. Hairer, S. Nørsett, G. Wanner, "Solving Ordinary Differential Equations I", 1993,
    section II.1.
    """

    def ahead(slope: P, step: Scalar) -> P:
        return jax.tree.map(lambda at, by: at + step * by, x, slope)

    first = rates(x)
    if rule == "euler":
        return ahead(first, dt)
    second = rates(ahead(first, dt / 2))
    third = rates(ahead(second, dt / 2))
    fourth = rates(ahead(third, dt))
    slopes = first, second, third, fourth
    whole = jax.tree.map(lambda a, b, c, d: a + 2 * (b + c) + d, *slopes)
    return ahead(whole, dt / 6)
