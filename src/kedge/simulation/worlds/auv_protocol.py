"""Published experiments with underwater vehicles: a path that is given, or no pilot."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Key, PRNGKeyArray

from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.quantities import (
    AngularRate3,
    Force,
    Radians,
    Ratio,
    Scalar,
    Speed,
    Torque,
    Velocity3,
    YawRate,
)
from kedge.core.registry import unknown, worlds
from kedge.core.rotations import direction
from kedge.numerics.noise import process_std
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.vehicles.underwater.level import State
from kedge.vehicles.underwater.underwater import Control

SHAPES = ("straight", "turning", "diving", "turning-dive")


class AbstractCommanded(AbstractWorld):
    """Filters are told of these commands, the same at all times."""

    thrust: Force = 3.86
    roll_torque: Torque = 0.0
    rudder: Radians = 0.0
    stern: Radians = 0.0

    def told(self, steps: int) -> Control:
        """The commands at every step."""
        values = self.thrust, self.roll_torque, self.rudder, self.stern
        return Control(*(jnp.full(steps, value, float) for value in values))


@worlds.add("underwater-path")
class UnderwaterPath(AbstractCommanded):
    r"""A path that is drawn, not sailed: it obeys no model, and no command changes it.

    Straight for ``straight`` steps at ``speed``, to the east; then its slope grows smoothly
    until ``share`` of the time is over; then it is straight again. With the share s of that
    stretch, "turning" turns to starboard with $r = 4 r_m s (1 - s)$, so that the slope in plan
    grows as $3 s^2 - 2 s^3$; "diving" slopes down by $\gamma = \gamma_m (1 - \cos \pi s) / 2$,
    as a velocity along its own down axis: the vehicle stays level; "turning-dive" does both.
    Positions are sums of the velocities, as Euler's rule has them.

    Raises:
        ContractError: an unknown shape.

    Source: Ngatini et al., "Comparison of AUV position estimation using Kalman filter,
    ensemble Kalman filter and fuzzy Kalman filter algorithm in the specified trajectories",
    2022, section 4: a straight start of 20 steps and a slope that changes gradually; its law
    and size are kedge's.
    """

    shape: str = eqx.field(static=True, default="straight")
    speed: Speed = 1.0
    straight: int = eqx.field(static=True, default=20)
    share: Ratio = 0.7
    turn: YawRate = 0.17
    slope: Radians = 0.2617993877991494

    def __check_init__(self):
        if self.shape not in SHAPES:
            raise ContractError(f"world: {unknown('shape', self.shape, list(SHAPES))}")

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        del key, sensing
        steps, dt = scenario.steps, scenario.dt
        number = jnp.arange(steps + 1) * 1.0
        grown = (number - self.straight) / (self.share * steps - self.straight)
        grown = jnp.clip(grown, 0.0, 1.0)
        none = jnp.zeros(steps + 1)
        rate, down = none, none
        if self.shape in ("turning", "turning-dive"):
            rate = -self.turn * 4 * grown * (1 - grown)
        if self.shape in ("diving", "turning-dive"):
            down = self.slope * (1 - jnp.cos(jnp.pi * grown)) / 2
        velocity = self.speed * jnp.stack([jnp.cos(down), none, -jnp.sin(down)], axis=1)
        heading = _sums(rate, dt)
        ahead = jax.vmap(direction)(heading)
        moving = jnp.concatenate([velocity[:, :1] * ahead, velocity[:, 2:]], axis=1)
        turning = jnp.stack([none, none, rate], axis=1)
        whole = State(_sums(moving, dt), heading, velocity, turning)
        start, path = (
            jax.tree.map(lambda leaf, cut=cut: leaf[cut], whole) for cut in (0, slice(1, None))
        )
        return History(path, self.told(steps), start)


@worlds.add("unpiloted")
class Unpiloted(AbstractCommanded):
    """The rig's own vehicle from a start that is given, with fixed commands.

    ``noise`` is how much of its noise density there is: none by default, so that the vehicle
    does exactly what the model says.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, chapter 7 (open-loop manoeuvres).
    """

    velocity: Velocity3 = eqx.field(default=(0.1, -0.1, -0.1), converter=jnp.asarray)
    rate: AngularRate3 = eqx.field(default=(0.1, -0.1, -0.1), converter=jnp.asarray)
    noise: Ratio = 0.0

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        del sensing
        vehicle, dt, steps = scenario.rig.vehicle, scenario.dt, scenario.steps
        start: Any = scenario.rig.prior.mean
        start = start._replace(velocity_body=self.velocity, angular_rate=self.rate)
        noises, commands = space(vehicle.noise_density()), self.told(steps)
        white = jax.random.normal(key, (steps, noises.size))
        shocks = self.noise * white * process_std(vehicle, dt)[None]

        def body(state: Any, inputs: Any) -> tuple[Any, Any]:
            control, shock = inputs
            after = vehicle.step(state, control, noises.unflatten(shock), dt)
            return after, after

        _, path = lax.scan(body, start, (commands, shocks))
        return History(path, commands, start)


def _sums(rates: Float[Array, "..."], dt: Scalar) -> Float[Array, "..."]:
    """Integrals from 0 on by Euler's rule."""
    before = jnp.concatenate([jnp.zeros_like(rates[:1]), rates[:-1]])
    return dt * jnp.cumsum(before, axis=0)
