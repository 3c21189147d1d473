"""Every registered vehicle keeps its contract; new ones are found without being named.

That its Jacobians are those of central differences (law 10) is part of the contract.
"""

import jax.numpy as jnp
import pytest

from kedge.core import registry
from kedge.testing import check_vehicle
from kedge.vehicles.augmented import Drift, augment

STEPS = {"underwater": 0.005, "underwater-level": 0.002}
"""Of vehicles that are stiff at the random states: a hull that pitches by 1 rad/s is damped
with 45/s."""


@pytest.mark.parametrize("name", registry.vehicles.names())
def test_vehicle(name):
    check_vehicle(name, STEPS.get(name, 0.1))


def test_augmented_vehicle():
    """A walk, a drift back to the nominal value, and a parameter in the vehicle's own place."""
    slow = {"speed_scale": Drift(0.05), "yaw_rate_scale": Drift(0.02, time_constant=3.0)}
    vehicle = augment(registry.vehicles.make("unicycle"), slow, ())
    assert jnp.shape(vehicle.start().speed_scale) == ()
    check_vehicle(vehicle)
