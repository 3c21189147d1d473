import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.batch import estimate
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.gnss import Gnss
from kedge.sensors.landmarks import Landmarks
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import Unicycle


@pytest.fixture(scope="session")
def rig():
    """A unicycle with two sensors, one of them over a map and behind a gate."""
    sensors = (
        Installation("gnss", Gnss(), rate=2.0),
        Installation("camera", Landmarks(), gate=1e-4),
    )
    return Rig(Unicycle(), sensors, Gaussian(Unicycle().start(), 0.1 * jnp.eye(3)))


@pytest.fixture(scope="session")
def extended(rig, log):
    """The extended filter over that log with other schedules or readings: compiled once."""

    @quick_jit
    def run(schedule, readings):
        return estimate(
            ExtendedKalman(), rig, log._replace(schedule=schedule, readings=readings)
        )

    return lambda schedule=log.schedule, readings=log.readings: run(schedule, readings)


@pytest.fixture(scope="session")
def log(rig):
    """Three seconds of it, as host arrays: the first reading of the camera is at .2 s."""
    recording, _ = record(Scenario(rig, duration=3.0), jax.random.key(1), output_rate=5.0)
    return jax.tree.map(np.asarray, recording.log)
