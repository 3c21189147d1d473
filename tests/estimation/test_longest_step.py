"""A step beyond what the vehicle stays stable for is refused, before anything happens."""

import jax.numpy as jnp
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Rig
from kedge.filters.gaussian.dead_reckoning import DeadReckoning
from kedge.vehicles.constant_velocity import ConstantVelocity


class Stiff(ConstantVelocity):
    """One that would not stay stable."""

    def longest_step(self) -> float:
        return 0.5


def test_live():
    """With the limit named; times in between are the remedy, and the refused one can follow."""
    vehicle = Stiff()
    rig = Rig(vehicle, (), Gaussian(vehicle.start(), jnp.eye(4)))
    live = Estimator(DeadReckoning(), rig, start=10.0)
    message = (
        "event at 10.9 s: the step since the event before is 0.9 s, expected at most 0.5 s: "
        "beyond that the step of Stiff is not stable"
    )
    with pytest.raises(ContractError, match=message):
        live.push(10.9)
    assert live.time == 10.0
    for time in (10.45, 10.9):
        live.push(time)
    assert live.time == 10.9
