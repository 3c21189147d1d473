"""An omnidirectional robot whose wheels slip, told of by encoders that see only their spin."""

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Float, Key, PRNGKeyArray

from kedge.core.errors import ContractError
from kedge.core.quantities import Metres, Ratio, Scalar, Seconds, WheelRates
from kedge.core.rotations import direction, wrap
from kedge.simulation.routes import AbstractRoute, Place
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.vehicles.omnidirectional import Control, Noise, Omnidirectional, State, Twist

AVERAGED = 0.02
"""Time in s over which the white loss of a wheel has its standard deviation."""


class OmniRobot(AbstractWorld):
    r"""Commands that would keep an ideal robot on its route, and wheels that do less than told.

    Each step commands the twist from one place of the route to the next, seen from the heading
    half-way. Wheel i moves the body as if it turned at
    $\dot\varphi_i (1 - b_i)(1 - s_i - n_i)$: b is one number for a run, n is white (its mean
    over 20 ms has ``white_std``), and s is lost in slip events, which begin as a Poisson
    process, last for an exponential time and lose a share between two bounds; a new one ends
    the one before. ``slip`` multiplies b, n and s.

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
    slip: Ratio = 1.0
    bias_std: Ratio = 0.01
    white_std: Ratio = 0.02
    event_rate: Scalar = 0.1  # 1/s, of each wheel
    event_duration: Seconds = 0.3
    least_loss: Ratio = 0.3
    most_loss: Ratio = 0.8
    encoder_rate: float = eqx.field(static=True, default=50.0)  # Hz
    counts: Scalar = 2048.0  # per turn
    delay: Seconds = 0.02
    missed: Ratio = 0.0

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        del sensing
        robot = Omnidirectional(self.radius, self.arm)
        slip_key, encoder_key = jr.split(key)
        places = jax.vmap(self.route.at)(jnp.arange(scenario.steps + 1) * scenario.dt)
        spins = jax.vmap(robot.wheel_rates)(_twists(places, scenario.dt))
        calm = Noise(jnp.zeros(4), jnp.zeros(2), jnp.zeros(()))

        def body(state: State, wheels: WheelRates) -> tuple[State, State]:
            state = robot.step(state, Control(wheels), calm, scenario.dt)
            return state, state

        start = State(places.position[0], places.heading[0])
        grips = self.grips(slip_key, scenario.steps, scenario.dt)
        _, path = lax.scan(body, start, spins * grips)
        return History(path, Control(self.told(encoder_key, spins, scenario.dt)), start)

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
        begins = jr.uniform(keys[2], (steps, 4)) < -jnp.expm1(-self.event_rate * dt)
        losses = jr.uniform(keys[3], (steps, 4), minval=self.least_loss, maxval=self.most_loss)
        lengths = self.event_duration / dt * jr.exponential(keys[4], (steps, 4))

        # The latest event that began, and how much of the step is left of it.
        number = jnp.arange(steps)[:, None]
        latest = lax.cummax(jnp.where(begins, number, -1))
        there = jnp.maximum(latest, 0)
        left = jnp.take_along_axis(lengths, there, axis=0) - (number - latest)
        share = jnp.where(latest < 0, 0.0, jnp.clip(left, 0.0, 1.0))
        events = share * jnp.take_along_axis(losses, there, axis=0)
        return (1 - self.slip * bias)[None] * (1 - self.slip * (events + white))

    def told(
        self, key: PRNGKeyArray, spins: Float[Array, "K 4"], dt: float
    ) -> Float[Array, "K 4"]:
        """Wheel rates by the encoders, held from one reading of them to the next.

        Raises:
            ContractError: the encoders are not read after a whole number of steps.
        """
        every = round(1 / (self.encoder_rate * dt))
        if every < 1 or not math.isclose(every * self.encoder_rate * dt, 1.0, rel_tol=1e-6):
            raise ContractError(
                f"world: encoder_rate is {self.encoder_rate:g} Hz, expected a whole number of "
                f"steps of {dt:g} s from one reading to the next"
            )
        phase_key, missed_key = jr.split(key)
        steps = len(spins)
        readings = -(-steps // every)
        turned = jnp.concatenate([jnp.zeros((1, 4)), jnp.cumsum(spins * dt, axis=0)])
        at = jnp.arange(readings + 1) * every - self.delay / dt
        angles = jax.vmap(lambda angle: jnp.interp(at, jnp.arange(steps + 1.0), angle), 1, 1)(
            turned
        )
        per_radian = self.counts / (2 * jnp.pi)
        ticks = jnp.floor(angles * per_radian + jr.uniform(phase_key, (4,))[None])
        seen = self.caught(missed_key, jnp.diff(ticks, axis=0))
        rates = seen / (per_radian * every * dt)
        return jnp.repeat(rates, every, axis=0)[:steps]

    def caught(self, key: PRNGKeyArray, counts: Float[Array, "M 4"]) -> Float[Array, "M 4"]:
        """The counts without those that were missed."""

        def thinned() -> Float[Array, "M 4"]:
            lost = jr.binomial(key, jnp.abs(counts), self.missed, dtype=counts.dtype)
            return counts - jnp.sign(counts) * lost

        return lax.cond(self.missed > 0, thinned, lambda: counts)


def _twists(places: Place, dt: float) -> Twist:
    """The twists of the body that lead from each place to the next."""
    turn = jax.vmap(wrap)(jnp.diff(places.heading))
    moved = jnp.diff(places.position, axis=0)

    def seen(offset: Float[Array, "2"], heading: Scalar) -> Float[Array, "2"]:
        return jnp.stack(
            [direction(heading) @ offset, direction(heading + jnp.pi / 2) @ offset]
        )

    velocity = jax.vmap(seen)(moved, places.heading[:-1] + turn / 2) / dt
    return Twist(velocity, turn / dt)
