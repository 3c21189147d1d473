"""A point on its route, of which filters hear a noisy acceleration and nothing else."""

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Key, PRNGKeyArray

from kedge.core.quantities import AccelerationNoise, Seconds
from kedge.core.registry import worlds
from kedge.simulation.routes import AbstractRoute
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.vehicles.constant_velocity import State
from kedge.vehicles.inertial_point import Control


@worlds.add("measured-point")
class MeasuredPoint(AbstractWorld):
    r"""The truth is the route; the control is its acceleration plus white noise.

    $\tilde a_k = (v_{k+1} - v_k) / \Delta t + n_k$ with $n_k \sim N(0, N^2 / \Delta t)$. A
    filter that only integrates it is off by $\sqrt{p_0^2 + \tfrac23 N^2 t^3}$ in the plane
    after t.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 6.2.2.
    """

    route: AbstractRoute
    acceleration_noise: AccelerationNoise = 0.0039
    delay: Seconds = 0.0
    """How long it stands at the route's beginning before it sets out."""

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        del sensing
        dt, steps = scenario.dt, scenario.steps
        time = jnp.arange(steps + 1) * dt
        places = jax.vmap(self.route.at)(jnp.maximum(time - self.delay, 0.0))
        moving = (time >= self.delay)[:, None]
        velocity = jnp.where(moving, places.velocity, 0.0)
        white = jr.normal(key, (steps, 2)) * self.acceleration_noise / jnp.sqrt(dt)
        reported = Control(jnp.diff(velocity, axis=0) / dt + white)
        path = State(places.position[1:], velocity[1:])
        return History(path, reported, State(places.position[0], velocity[0]))
