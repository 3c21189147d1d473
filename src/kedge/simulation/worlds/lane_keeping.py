"""A car that keeps its lane at constant speed, blown about, steered by what is believed."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.quantities import Curvature, Metres, Radians, Scalar, SteeringAngle
from kedge.core.registry import worlds
from kedge.numerics.noise import process_std
from kedge.simulation.guidance import lane_keeper, like, steady_turn
from kedge.simulation.loop import AbstractGuidedWorld
from kedge.simulation.routes import Lane
from kedge.simulation.scenario import History, Scenario
from kedge.vehicles.augmented import Augmented
from kedge.vehicles.lateral_tracking import (
    AbstractLateral,
    Control,
    LateralTracking,
    Noise,
    State,
)


class Ahead(NamedTuple):
    """By step."""

    time: Float[Array, "*K"]

    gusts: Noise
    bend: Float[Array, "*K"]
    """The curvature of the path, whoever knows it."""


@worlds.add("lane-keeping")
class LaneKeeping(AbstractGuidedWorld):
    r"""The rig's car in its nonlinear form, in the middle of a bending lane or next to it.

    It begins ``offset`` to the left of the path, straight and at the right speed, and is
    blown about by the noise of the rig's vehicle; what moves has the true parameters. A
    quadratic regulator steers it into the bend. Filters are told steering angle, acceleration
    and the path's curvature; unless ``curvature_known`` is true, they and the guidance take the
    path for straight.

    Studies report the offset, the heading error and the rate at which it steers.

    Source: R. Rajamani, "Vehicle Dynamics and Control", 2nd ed., 2012, chapters 2 and 3.
    """

    drives: ClassVar = True
    watches: ClassVar = ("offset", "heading_error", "steering_rate")

    route: Lane = Lane()
    offset: Metres = 1.0
    offset_scale: Metres = 0.3
    heading_scale: Radians = 0.05
    steering_scale: SteeringAngle = 0.03
    steering_limit: SteeringAngle = 0.1
    speed_gain: Scalar = 0.5  # 1/s
    curvature_known: bool = True

    def begin(self, scenario: Scenario, key: PRNGKeyArray) -> tuple[State, Ahead]:
        car, none = _car(scenario), jnp.zeros(())
        start = State(none, none, jnp.asarray(self.offset), none, none)
        noises = space(car.noise_density())
        white = jr.normal(key, (scenario.steps, noises.size))
        gusts = jax.vmap(noises.unflatten)(white * process_std(car, scenario.dt)[None])
        times = jnp.arange(scenario.steps) * scenario.dt
        bends: Any = jax.vmap(self.route.bend)(times)
        return start, Ahead(times, gusts, bends)

    def state(self, body: State) -> State:
        return body

    def intended(self, scenario: Scenario, time: Scalar) -> State:
        return steady_turn(_car(scenario), self.known(time))[0]

    def guidance(self, scenario: Scenario) -> Callable[[State, Scalar], Control]:
        scales = self.offset_scale, self.heading_scale, self.steering_scale
        limits = self.steering_limit, self.speed_gain
        keeper = lane_keeper(_car(scenario), scenario.dt, *scales, *limits)

        def steer(believed: State, time: Scalar) -> Control:
            curvature = self.known(time)
            return Control(*keeper.command(believed, curvature), curvature)

        return steer

    def known(self, time: Scalar) -> Curvature:
        """The curvature at a time, as it is told."""
        return jnp.where(self.curvature_known, self.route.bend(time), 0.0)

    def move(
        self, scenario: Scenario, body: State, command: Control, draws: Ahead
    ) -> tuple[State, Control]:
        time, gusts, bend = jax.tree.map(lambda leaf: leaf[0], draws)
        bending = command._replace(curvature=bend)
        body = _lateral(scenario.vehicle_at(time)).step(body, bending, gusts, scenario.dt)
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (body, command))

    def watch(self, scenario: Scenario, history: History) -> Float[Array, "K w"]:
        steering = history.controls.steering
        change = jnp.diff(steering, prepend=steering[:1]) / scenario.dt
        return jnp.stack([history.path.offset, history.path.heading_error, change], axis=1)


def _car(scenario: Scenario) -> LateralTracking:
    """The car as guidance and filters know it."""
    known = scenario.rig.vehicle
    return _lateral(known.vehicle if isinstance(known, Augmented) else known)


def _lateral(vehicle: AbstractVehicle) -> LateralTracking:
    if not isinstance(vehicle, AbstractLateral):
        raise ContractError(
            f"world: a {type(vehicle).__name__} cannot keep a lane; expected the vehicle "
            "lateral-tracking or lateral-tracking-linear"
        )
    return like(vehicle, LateralTracking)
