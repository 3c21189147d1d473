"""A sensor of chosen components: what it picks, and how far that is from the rest."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.estimation.rig import Installation, Rig
from kedge.sensors.components import Components
from kedge.vehicles.benchmarks.lorenz96 import Lorenz96, ring
from kedge.vehicles.constant_velocity import ConstantVelocity


def test_every_stride_th_or_those_listed():
    state = ring(7)(10.0 * jnp.arange(7))
    seen = Components(size=7, first=1, stride=3).expect(state)
    np.testing.assert_array_equal(seen.values, [10, 40])
    listed = Components(size=7, indices=(5, 0, 6), std=0.5)
    np.testing.assert_array_equal(listed.expect(state).values, [50, 0, 60])
    np.testing.assert_array_equal(listed.noise_cov(state), 0.25 * np.eye(3))
    np.testing.assert_array_equal(listed.noise_variance(state), [0.25] * 3)
    assert listed.dof() == 3


def test_distances_go_the_shorter_way_round():
    state = ring(6)(jnp.zeros(6))
    around = Components(size=6, indices=(0, 4)).distances(state)
    np.testing.assert_array_equal(around, [[0, 1, 2, 3, 2, 1], [2, 3, 2, 1, 0, 1]])
    line = Components(size=6, indices=(4,), ring=False).distances(state)
    np.testing.assert_array_equal(line, [[4, 3, 2, 1, 0, 1]])


def test_it_reads_a_vector_of_any_vehicle():
    """Fields that it does not read have no place, and no distance."""
    vehicle = ConstantVelocity()
    sensor = Components(field="velocity", size=2, unit="m/s", indices=(1,))
    Rig(vehicle, (Installation("drift", sensor),), Gaussian(vehicle.start(), jnp.eye(4)))
    np.testing.assert_array_equal(sensor.expect(vehicle.start()).velocity, [0.5])
    np.testing.assert_array_equal(
        sensor.distances(vehicle.start()), [[np.nan, np.nan, 1.0, 0.0]]
    )


def test_another_size_does_not_fit():
    vehicle, sensor = Lorenz96(size=8), Components(size=9)
    with pytest.raises(ContractError, match=r"Components .*reads"):
        Rig(vehicle, (Installation("all", sensor),), Gaussian(vehicle.start(), jnp.eye(8)))


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"size": 0}, "size is 0 and stride 1, both must be at least 1"),
        ({"stride": 0}, "stride 0, both must be at least 1"),
        ({"size": 4, "indices": (1, 4)}, "indices .1, 4., must be at least 0 and below"),
        ({"size": 4, "first": 4}, "first 4, must be at least 0 and below the size, 4"),
        ({"size": 4, "first": -2}, "first -2, must be at least 0 and below the size, 4"),
    ],
)
def test_bad_parameters(parameters, says):
    with pytest.raises(ContractError, match=says):
        Components(**parameters)
