"""An omnidirectional robot whose wheels slip, told of by encoders that see only their spin."""

import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from kedge.core.errors import ContractError
from kedge.core.quantities import Metres, Ratio, Scalar, Seconds, WheelRates
from kedge.core.registry import worlds
from kedge.core.rotations import direction, wrap
from kedge.estimation.rig import Installation
from kedge.simulation.guidance import follow
from kedge.simulation.loop import AbstractGuidedWorld
from kedge.simulation.routes import AbstractRoute, Place
from kedge.simulation.scenario import History, Scenario
from kedge.vehicles.omnidirectional import Control, Noise, Omnidirectional, State, Twist

AVERAGED = 0.02
"""Time in s over which the white loss of a wheel has its standard deviation."""


class Body(NamedTuple):
    """The robot and its encoders."""

    state: State
    angles: Float[Array, "D 4"]
    """How far each wheel had turned at the ends of the latest steps; rad."""
    ticks: Float[Array, "4"]
    """The counts when the encoders were last read."""
    phases: Float[Array, "4"]
    """Where between two counts each wheel began."""


class Draws(NamedTuple):
    """By step."""

    grips: Float[Array, "*K 4"]
    """The share of its spin by which each wheel moves the body."""
    misses: Key[Array, "*K"]


@worlds.add("omnidirectional")
class OmniRobot(AbstractGuidedWorld):
    r"""Four commanded wheels that slip, on a route that is followed by what is believed.

    From one reading of the encoders to the next, the commands are the twist from the route's
    place to its next one, corrected in proportion to what is believed to be missing
    (:func:`kedge.simulation.guidance.follow`), seen from the heading half-way. Without feedback
    an ideal robot is at the next place. Wheel i moves the body as if it turned at
    $\dot\varphi_i (1 - b_i)(1 - s_i - n_i)$: b is one number for a run, n is white (its mean
    over 20 ms has ``white_std``), and s is lost in slip events, which begin as a Poisson
    process, last for an exponential time and lose a share between two bounds; a new one ends
    the one before. ``slip`` multiplies b, n and the rate of events.

    Filters are told of wheel rates: the counts of encoders between two readings of them, and
    both were taken ``delay`` before. Encoders see a wheel spin, not slip. Each count is missed
    with the probability ``missed``.

    Source: R. Dixon, G. Bright, R. Harley, "Robust localisation of automated guided vehicles
    for computer-integrated manufacturing environments", 2013, section 4 names these errors;
    the paper has no numbers, so all of these are kedge's.
    """

    watches: ClassVar = ("position", "heading")
    """Distance from the place on the route in m, and the angle between both headings in rad."""
    route: AbstractRoute
    radius: Metres = 0.05
    arm: Metres = 0.20
    gain: Scalar = 1.0  # 1/s
    turn_gain: Scalar = 2.0  # 1/s
    slip: Ratio = 1.0
    bias_std: Ratio = 0.01
    white_std: Ratio = 0.02
    event_rate: Scalar = 0.1  # 1/s, of each wheel
    event_duration: Seconds = 0.3
    least_loss: Ratio = 0.3
    most_loss: Ratio = 0.8
    encoder_rate: float = eqx.field(static=True, default=50.0)  # Hz
    delay: float = eqx.field(static=True, default=0.02)  # s
    counts: Scalar = 2048.0  # per turn
    missed: float = eqx.field(static=True, default=0.0)
    """Static, since drawing what is missed takes a third of the time of compiling."""

    def __check_init__(self):
        for name in ("radius", "arm", "counts", "encoder_rate"):
            if not getattr(self, name) > 0:
                raise ContractError(f"world: {name} is {getattr(self, name)}, expected above 0")
        if not 0 <= self.missed <= 1:
            raise ContractError(f"world: missed is {self.missed}, expected a share from 0 to 1")
        if not 0 <= self.delay < math.inf:
            raise ContractError(f"world: delay is {self.delay} s, expected 0 or more")

    def hold(self, scenario: Scenario) -> int:
        """From one reading of the encoders to the next.

        Raises:
            ContractError: that is no whole number of steps.
        """
        every = round(1 / (self.encoder_rate * scenario.dt))
        if every < 1 or not math.isclose(every * self.encoder_rate * scenario.dt, 1.0):
            raise ContractError(
                f"world: encoder_rate is {self.encoder_rate:g} Hz, expected a whole number of "
                f"steps of {scenario.dt:g} s from one reading to the next"
            )
        return every

    def begin(self, scenario: Scenario, key: PRNGKeyArray) -> tuple[Body, Draws]:
        slip_key, phase_key, missed_key = jr.split(key, 3)
        start = self.intended(scenario, 0.0)
        kept = math.ceil(self.delay / scenario.dt - 1e-9) + 1
        phases = jr.uniform(phase_key, (4,))
        body = Body(start, jnp.zeros((kept, 4)), jnp.zeros(4), phases)
        grips = self.grips(slip_key, scenario.steps, scenario.dt)
        return body, Draws(grips, jr.split(missed_key, scenario.steps))

    def state(self, body: Body) -> State:
        return body.state

    def intended(self, scenario: Scenario, time: Scalar) -> State:
        place = self.route.at(time)
        return State(place.position, place.heading)

    def guidance(self, scenario: Scenario) -> Callable[[State, Scalar], WheelRates]:
        span, robot = self.hold(scenario) * scenario.dt, self._robot()

        def steer(believed: State, time: Scalar) -> WheelRates:
            here, next_place = self.route.at(time), self.route.at(time + span)
            velocity = (next_place.position - here.position) / span
            turning = wrap(next_place.heading - here.heading) / span
            place = Place(here.position, velocity, here.heading, turning)
            velocity, turning = follow(place, *believed, self.gain, self.turn_gain)
            heading = believed.heading + turning * span / 2
            ahead, left = direction(heading), direction(heading + jnp.pi / 2)
            twist = Twist(jnp.stack([ahead @ velocity, left @ velocity]), turning)
            return robot.wheel_rates(twist)

        return steer

    def move(
        self, scenario: Scenario, body: Body, command: WheelRates, draws: Draws
    ) -> tuple[Body, Control]:
        dt, robot, hold = scenario.dt, self._robot(), len(draws.grips)
        calm = Noise(jnp.zeros(4), jnp.zeros(2), jnp.zeros(()))
        ticks, bodies = body.ticks, []
        for step in range(hold):
            slipping = Control(command * draws.grips[step])
            angles = jnp.concatenate([body.angles, (body.angles[-1] + command * dt)[None]])
            state = robot.step(body.state, slipping, calm, dt)
            body = Body(state, angles[1:], ticks, body.phases)
            bodies.append(body)
        # The wheels' angles ``delay`` ago: between the two oldest that are kept.
        old, share = body.angles, len(body.angles) - 1 - self.delay / dt
        angle = old[0] if len(old) == 1 else old[0] + share * (old[1] - old[0])
        per_radian = self.counts / (2 * jnp.pi)
        now = jnp.floor(angle * per_radian + body.phases)
        rates = self.caught(draws.misses[0], now - ticks) / (per_radian * hold * dt)
        bodies[-1] = body._replace(ticks=now)
        return (
            jax.tree.map(lambda *leaves: jnp.stack(leaves), *bodies),
            Control(jnp.broadcast_to(rates, (hold, 4))),
        )

    def fix(self, installation: Installation, target: Int[Array, ""], reading: Any) -> dict:
        """The pose at which a landmark would be seen exactly so."""
        camera: Any = installation.sensor.for_target(target)
        landmark = camera.target
        heading = wrap(landmark.heading - reading.orientation)
        ahead, left = direction(heading), direction(heading + jnp.pi / 2)
        offset = ahead * reading.offset[0] + left * reading.offset[1]
        return {"position": landmark.position - offset, "heading": heading}

    def watch(self, scenario: Scenario, history: History) -> Float[Array, "K 2"]:
        times = jnp.arange(1, scenario.steps + 1) * scenario.dt
        places = jax.vmap(self.route.at)(times)
        away = history.path.position - places.position
        turned = jax.vmap(wrap)(history.path.heading - places.heading)
        return jnp.stack([jnp.hypot(away[:, 0], away[:, 1]), turned], axis=1)

    def grips(self, key: PRNGKeyArray, steps: int, dt: float) -> Float[Array, "K 4"]:
        """The share of its spin by which each wheel moves the body in each step."""
        keys = jr.split(key, 5)
        bias = self.bias_std * jr.normal(keys[0], (4,))
        white = self.white_std * jnp.sqrt(AVERAGED / dt) * jr.normal(keys[1], (steps, 4))
        begins = jr.uniform(keys[2], (steps, 4)) < -jnp.expm1(-self.slip * self.event_rate * dt)
        losses = jr.uniform(keys[3], (steps, 4), minval=self.least_loss, maxval=self.most_loss)
        lengths = self.event_duration / dt * jr.exponential(keys[4], (steps, 4))

        # The latest event that began, and how much of the step is left of it.
        number = jnp.arange(steps)[:, None]
        latest = lax.cummax(jnp.where(begins, number, -1))
        event = jnp.maximum(latest, 0)
        remaining = jnp.take_along_axis(lengths, event, axis=0) - (number - latest)
        share = jnp.where(latest < 0, 0.0, jnp.clip(remaining, 0.0, 1.0))
        events = share * jnp.take_along_axis(losses, event, axis=0)
        return (1 - self.slip * bias)[None] * (1 - events - self.slip * white)

    def caught(self, key: PRNGKeyArray, counts: Float[Array, "4"]) -> Float[Array, "4"]:
        """The counts without those that were missed."""
        if self.missed == 0:
            return counts
        lost = jr.binomial(key, jnp.abs(counts), self.missed, dtype=counts.dtype)
        return counts - jnp.sign(counts) * lost

    def _robot(self) -> Omnidirectional:
        return Omnidirectional(self.radius, self.arm)
