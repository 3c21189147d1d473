"""A tag that is put down at one surveyed point after the other."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, Key, PRNGKeyArray

from kedge.core.errors import ContractError
from kedge.core.quantities import Seconds
from kedge.core.registry import worlds
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.vehicles.still import Control, State


@worlds.add("surveyed-points")
class SurveyedPoints(AbstractWorld):
    """For ``stay`` seconds at each of the ``points`` in turn, and round again.

    Source: J. Qiu, Y. Zhang, M. Tang, P. Ma, J. Ran, "Research on AGV positioning method
    combined with IMU and UWB", Archives of Transport 64(4), 2022, section 5.1.
    """

    points: tuple[tuple[float, ...], ...] = ((0.0, 0.0), (1.0, 0.0))
    stay: Seconds = 1.0

    def __check_init__(self):
        if not self.points or any(len(point) != 2 for point in self.points):
            raise ContractError("points: expected some, each as x and y")

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        del key, sensing
        steps = jnp.arange(1, scenario.steps + 1)
        # A point's last moment is its own: at t = stay the tag still stands on the first.
        visit = jnp.ceil(steps * scenario.dt / self.stay - 1e-9).astype(int) - 1
        path = self.places()[visit % len(self.points)]
        return History(State(path), Control(), State(self.places()[0]))

    def places(self) -> Float[Array, "n 2"]:
        """The points as an array."""
        points: Any = [jnp.stack([jnp.asarray(x) for x in point]) for point in self.points]
        return jnp.stack(points)
