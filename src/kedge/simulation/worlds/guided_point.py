"""A point that is led along a route, of which its filters know nothing."""

from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Key, PRNGKeyArray

from kedge.core.quantities import Acceleration, Scalar
from kedge.core.registry import worlds
from kedge.simulation.routes import AbstractRoute
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.vehicles.constant_velocity import ConstantVelocity, Control, Noise, State


@worlds.add("guided-point")
class GuidedPoint(AbstractWorld):
    r"""A point that is blown off its route and led back: the route plus an error.

    $e' = F e + G (-k_p e_p - k_v e_v + \sigma n)$ with F and G of the constant velocity, n
    standard normal and drawn anew at each step. Without noise the point is on its route.
    Filters are told of no control.

    Source: K. Oktafianto et al., "Trajectory Estimation of Automated Guided Vehicle Based
    on Linear Modelling Using Ensemble Kalman Filter": the rectangle; the guidance is kedge's,
    as the article says nothing of one, and constant velocity alone cannot turn.
    """

    route: AbstractRoute
    acceleration_std: Acceleration = 0.1
    position_gain: Scalar = 1.0  # 1/s^2
    velocity_gain: Scalar = 1.4  # 1/s

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        del sensing
        dt = scenario.dt
        gusts = self.acceleration_std * jr.normal(key, (scenario.steps, 2))

        point = ConstantVelocity()

        def body(error: State, gust: Any) -> tuple[State, State]:
            led = -self.position_gain * error.position - self.velocity_gain * error.velocity
            error = point.step(error, Control(), Noise(led + gust), dt)
            return error, error

        _, errors = lax.scan(body, State(jnp.zeros(2), jnp.zeros(2)), gusts)
        places = jax.vmap(self.route.at)(jnp.arange(scenario.steps + 1) * dt)
        route = State(places.position, places.velocity)
        start = jax.tree.map(lambda leaf: leaf[0], route)
        path = jax.tree.map(lambda leaf, error: leaf[1:] + error, route, errors)
        return History(path, Control(), start)
