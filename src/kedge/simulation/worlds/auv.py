"""An underwater vehicle under its autopilot, in a current, whose hull nobody knows exactly."""

import dataclasses
import functools as ft
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.errors import ContractError
from kedge.core.manifolds import charts_of, space_of
from kedge.core.quantities import (
    AccelerationNoise,
    Metres,
    Ratio,
    Scalar,
    SpeedNoise,
    Velocity3,
    YawAccelerationNoise,
)
from kedge.core.registry import worlds
from kedge.core.rotations import direction, exp, matrix_of, wrap
from kedge.estimation.error_states import error_states
from kedge.numerics.linalg import square_root
from kedge.numerics.noise import process_std
from kedge.simulation.autopilot import Autopilot, Target
from kedge.simulation.loop import AbstractGuidedWorld
from kedge.simulation.routes import AbstractRoute, Waypoints
from kedge.simulation.scenario import History, Scenario
from kedge.vehicles.augmented import Augmented
from kedge.vehicles.underwater.coefficient_files import as_coefficients
from kedge.vehicles.underwater.hydrodynamics import Coefficients
from kedge.vehicles.underwater.underwater import PITCH, Control, Noise, State, Underwater

TIED = {"Nvdot": "Yrdot", "Mwdot": "Zqdot"}
"""Coefficients that are one: the mass matrix is symmetric."""


class Body(NamedTuple):
    """What moves, and what nobody told the filters of it."""

    state: State
    current: Float[Array, "*K 3"]
    rest: Any
    """Whatever else the rig estimates, such as biases of its sensors."""
    hull: Coefficients
    trim_moment: Float[Array, "*K"]
    """The pitching moment that the nominal hull does not explain; N m, nose up positive."""


class Ahead(NamedTuple):
    """By step, in units of their standard deviations."""

    gusts: Float[Array, "*K 6"]
    drifts: Float[Array, "*K 3"]
    wanders: Float[Array, "*K n"]


@worlds.add("underwater")
class UnderwaterWorld(AbstractGuidedWorld):
    r"""The vehicle "underwater" on a route at a depth, steered by what is believed of it.

    Heading: that of the route, turned towards it by $\arctan(e / \Delta)$ for the distance e
    beside it and the ``lookahead`` $\Delta$. ``depths`` are points (time in s, depth in m) with
    straight lines between. Rudder, stern plane and thrust follow from
    :class:`kedge.simulation.autopilot.Autopilot`, which knows the nominal hull.

    Each hydrodynamic coefficient of a run is the nominal one times $1 + m U(-1, 1)$ with
    ``mismatch`` m. If the rig estimates a scale instead, that is drawn from its prior, and its
    coefficient is not wrong twice; the true ``trim_moment`` is what the nominal hull lacks of
    the pitching acceleration at each time. The current is ``current`` (east, north, up) and
    wanders by ``current_walk``. Whatever else the rig estimates (biases of sensors) is drawn
    from its prior and wanders as the rig says.

    Filters are told of the commands, fins as they stand. Studies report the distance from the
    route in plan, the depth's and the heading's deviation, and the root of the share of time
    at which a fin is asked for more than it can turn.

    Source: T. Fossen, "Handbook of Marine Craft Hydrodynamics and Motion Control", 2011,
    section 10.3 (line-of-sight guidance with a lookahead).
    """

    watches: ClassVar = ("cross_track", "depth", "heading", "fins_at_limit")

    route: AbstractRoute = Waypoints(((0.0, 0.0), (1000.0, 0.0)), 1.5)
    coefficients: Coefficients | str = eqx.field(
        default="remus100-adjusted", converter=as_coefficients
    )
    mismatch: Ratio = 0.0
    depths: tuple[tuple[float, float], ...] = eqx.field(static=True, default=((0.0, 5.0),))
    current: Velocity3 = eqx.field(default=(0.0, 0.0, 0.0), converter=jnp.asarray)
    current_walk: SpeedNoise = 0.0
    acceleration_noise: AccelerationNoise = 0.02
    angular_noise: YawAccelerationNoise = 0.02
    lookahead: Metres = 8.0
    autopilot: Autopilot = Autopilot()

    def __check_init__(self):
        times = [point[0] for point in self.depths if len(point) == 2]
        if len(times) != len(self.depths) or not times or times != sorted(set(times)):
            raise ContractError(
                f"world: depths is {self.depths}, expected points (time in s, depth in m), "
                "the times ascending"
            )
        if np.shape(self.current) != (3,):
            raise ContractError(
                f"world: current has the shape {np.shape(self.current)}, expected 3 "
                "components: east, north, up (m/s)"
            )
        if isinstance(self.mismatch, float | int) and not 0 <= self.mismatch < 1:
            raise ContractError(
                f"world: mismatch is {self.mismatch:g}, expected 0 or more, below 1"
            )

    def begin(self, scenario: Scenario, key: PRNGKeyArray) -> tuple[Body, Ahead]:
        keys, prior = jr.split(key, 4), scenario.rig.prior
        states = space_of(type(prior.mean))
        white = square_root(prior.cov) @ jr.normal(keys[0], (states.size,))
        drawn, parameters = states.boxplus(prior.mean, white), _slow(scenario)
        hull = self.mistaken(keys[1], [SCALES[name] for name in parameters if name in SCALES])
        body = Body(
            self.intended(scenario, 0.0),
            jnp.asarray(self.current, float),
            {name: getattr(drawn, name) for name in parameters},
            hull,
            jnp.zeros(()),
        )
        if _trims(scenario):
            command = self.guidance(scenario)(body.state, 0.0)
            body = body._replace(trim_moment=self.unexplained(body, command))
        size = sum(charts_of(states.cls)[name].size for name in parameters)
        steps = scenario.steps
        gusts = jr.normal(keys[2], (steps, 9))
        wanders = jr.normal(keys[3], (steps, size))
        return body, Ahead(gusts[:, :6], gusts[:, 6:], wanders)

    def mistaken(self, key: PRNGKeyArray, known: Sequence[str | None] = ()) -> Coefficients:
        """A hull that differs from the nominal one in every hydrodynamic coefficient.

        Not in those ``known``: what the rig estimates instead is drawn from its prior, and is
        wrong once, not twice.
        """
        nominal = as_coefficients(self.coefficients)
        names = [n for n in nominal.values() if n[0] in "XYZKMN" and "prop" not in n]
        off = 1 + self.mismatch * jr.uniform(key, (len(names),), minval=-1.0)
        factor = dict(zip(names, off, strict=True))
        factor |= {name: factor[other] for name, other in TIED.items()}
        factor |= {name: 1.0 for name in known if name is not None}
        return nominal.changed(**{n: getattr(nominal, n) * f for n, f in factor.items()})

    def state(self, body: Body) -> Any:
        extras = body.current, body.trim_moment, *body.rest.values()
        return _truth(tuple(body.rest))(*body.state, *extras)

    def true_vehicle(self, body: Body) -> Underwater:
        """The hull that nobody knows, with what the rig estimates of it."""
        return Underwater(
            body.hull,
            current=body.current,
            acceleration_noise=self.acceleration_noise,
            angular_noise=self.angular_noise,
            **{name: body.rest[name] for name in SCALES if name in body.rest},
        )

    def unexplained(self, body: Body, command: Control) -> Float[Array, ""]:
        """The moment that gives the nominal hull the pitching acceleration of the true one."""
        true, nominal = self.true_vehicle(body), as_coefficients(self.coefficients)
        known = dataclasses.replace(true, coefficients=nominal)
        pulls = [vehicle.accelerations(body.state, command) for vehicle in (true, known)]
        return (pulls[0] - pulls[1])[PITCH] / nominal.compliance()[PITCH, PITCH]

    def intended(self, scenario: Scenario, time: Scalar) -> Any:
        place, (depth, sinking) = self.route.at(time), self.sounding(time)
        turned = exp(jnp.zeros(3).at[2].set(place.heading))
        ahead = jnp.hypot(place.velocity[0], place.velocity[1])
        velocity = jnp.zeros(3).at[0].set(ahead).at[2].set(-sinking)
        rate = jnp.zeros(3).at[2].set(place.yaw_rate)
        position = jnp.append(place.position, -depth)
        return State(position, turned, velocity, rate)

    def sounding(self, time: Scalar) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Depth in m and its rate in m/s at a time."""
        if len(self.depths) == 1:
            return jnp.asarray(self.depths[0][1], float), jnp.zeros(())
        times, depths = (
            jnp.asarray(column, float) for column in zip(*self.depths, strict=True)
        )
        slopes = jnp.concatenate(
            [jnp.zeros(1), jnp.diff(depths) / jnp.diff(times), jnp.zeros(1)]
        )
        piece = jnp.searchsorted(times, time, side="right")
        return jnp.interp(jnp.asarray(time), times, depths), slopes[piece]

    def guidance(self, scenario: Scenario) -> Callable[[Any, Scalar], Control]:
        hull = as_coefficients(self.coefficients)

        def steer(believed: Any, time: Scalar) -> Control:
            place, (depth, sinking) = self.route.at(time), self.sounding(time)
            along = direction(place.heading)
            off = believed.position[:2] - place.position
            aside = along[0] * off[1] - along[1] * off[0]
            behind = -(along @ off)
            heading = place.heading - jnp.arctan(aside / self.lookahead)
            cruise = jnp.hypot(place.velocity[0], place.velocity[1])
            speed = cruise * (1 + jnp.clip(behind / self.lookahead, -0.3, 0.3))
            target = Target(heading, place.yaw_rate, depth, sinking, speed)
            return self.autopilot.command(hull, believed, target)

        return steer

    def move(
        self, scenario: Scenario, body: Body, command: Control, draws: Ahead
    ) -> tuple[Body, Any]:
        gusts, drifts, wanders = jax.tree.map(lambda leaf: leaf[0], draws)
        root = jnp.sqrt(scenario.dt)
        vehicle = self.true_vehicle(body)
        shaken = gusts * process_std(vehicle, scenario.dt)
        noise = Noise(shaken[:3], shaken[3:])
        state = vehicle.step(body.state, command, noise, scenario.dt)
        drifting = self.current_walk * root * drifts
        parameters, augmented = {}, _slow(scenario)
        for name, value in body.rest.items():
            process, size = augmented[name], max(jnp.size(value), 1)
            white, wanders = wanders[:size].reshape(jnp.shape(value)), wanders[size:]
            decay = jnp.exp(-scenario.dt / jnp.asarray(process.time_constant))
            parameters[name] = (
                process.nominal
                + (value - process.nominal) * decay
                + process.random_walk * root * white
            )
        after = Body(state, body.current + drifting, parameters, body.hull, body.trim_moment)
        if _trims(scenario):
            after = after._replace(trim_moment=self.unexplained(after, command))
        reported = _told(scenario, command)
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], (after, reported))

    def watch(self, scenario: Scenario, history: History) -> Float[Array, "K w"]:
        times = jnp.arange(1, scenario.steps + 1) * scenario.dt
        places = jax.vmap(self.route.at)(times)
        path, along = history.path, jax.vmap(direction)(places.heading)
        off = path.position[:, :2] - places.position
        aside = along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0]
        deep = path.position[:, 2] + jax.vmap(self.sounding)(times)[0]
        turn = jax.vmap(matrix_of)(path.attitude)
        turned = jax.vmap(wrap)(jnp.arctan2(turn[:, 1, 0], turn[:, 0, 0]) - places.heading)
        limit, beyond = as_coefficients(self.coefficients).fin_limit, jnp.zeros_like(aside)
        if hasattr(history.controls, "rudder"):
            fins = jnp.stack([history.controls.rudder, history.controls.stern])
            beyond = jnp.where((jnp.abs(fins) >= limit).any(axis=0), 1.0, 0.0)
        return jnp.stack([aside, deep, turned, beyond], axis=1)


SCALES = {"thrust_scale": None, "drag_scale": "Xuu"}
"""What the true vehicle has too if the rig estimates it; what such a scale stands for."""
APART = ("current", "trim_moment")
"""What the rig may estimate, and the world has by itself."""


def _trims(scenario: Scenario) -> bool:
    """Whether the rig estimates a moment of trim."""
    return "trim_moment" in type(scenario.rig.prior.mean)._fields


def _slow(scenario: Scenario) -> dict[str, Any]:
    """What the rig estimates beside the vehicle's state, without what the world has itself."""
    vehicle = scenario.rig.vehicle
    if not isinstance(vehicle, Augmented):
        return {}
    errors = {name for sensor in scenario.rig.sensors for name in error_states(sensor)}
    apart = errors.union(APART)
    return {name: vehicle.augmented[name] for name, _ in vehicle.charts if name not in apart}


@ft.cache
def _truth(parameters: tuple[str, ...]) -> Any:
    """The class of the true state."""
    create: Any = NamedTuple
    return create("Truth", [(name, Any) for name in (*State._fields, *APART, *parameters)])


def _told(scenario: Scenario, command: Control) -> Any:
    """The command, with the fields that the rig's vehicle is driven by.

    Raises:
        ContractError: it is driven by something else.
    """
    cls = type(scenario.rig.vehicle.nominal_control(0.0))
    if lacking := [field for field in cls._fields if field not in Control._fields]:
        raise ContractError(
            f"world: the rig's vehicle is driven by {lacking}, of which this world knows "
            f"nothing; its commands are {list(Control._fields)}"
        )
    return cls(*(getattr(command, field) for field in cls._fields))
