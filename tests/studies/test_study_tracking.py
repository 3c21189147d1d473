"""What a world watches of its truth: root mean squares beside the filters' errors."""

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.dead_reckoning import DeadReckoning
from kedge.filters.gaussian.kalman import Kalman
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.studies.study import Study
from kedge.studies.summary import compare, summarise
from kedge.studies.trials import run_study
from kedge.vehicles.constant_velocity import ConstantVelocity, Control, State


class Runaway(AbstractWorld):
    """Leaves along the axis x with a speed that grows by 1 m/s in each step of 1 s."""

    watches: ClassVar = ("east", "speed")

    def unfold(self, scenario, key, sensing):
        time = jnp.arange(scenario.steps + 1) * scenario.dt
        along = jnp.stack([time, jnp.zeros_like(time)], axis=1)
        path = State(0.5 * time[:, None] * along, along)
        return History(
            State(*(leaf[1:] for leaf in path)), Control(), State(*(leaf[0] for leaf in path))
        )

    def watch(self, scenario, history):
        return jnp.stack([history.path.position[:, 0], history.path.velocity[:, 0]], axis=1)


@pytest.fixture(scope="module")
def study():
    vehicle = ConstantVelocity()
    sensor = Installation("gnss", Gnss(), rate=1.0)
    rig = Rig(vehicle, (sensor,), Gaussian(vehicle.start(), jnp.eye(4)))
    return Study(Scenario(rig, duration=6.0, dt=1.0, world=Runaway()), burn_in=3.0)


def test_root_mean_squares_after_the_burn_in_and_over_all_steps(study):
    results = run_study(study, {"kalman": Kalman(), "dead-reckoning": DeadReckoning()}, 3)
    found = summarise(study, results["kalman"])
    late, steps = np.array([4.0, 5.0, 6.0]), np.arange(1.0, 7.0)
    for scores, time in ((found.settled, late), (found.all_steps, steps)):
        expected = {
            "east": np.sqrt(np.mean(time**4 / 4)),
            "speed": np.sqrt(np.mean(time**2)),
        }
        for name, value in expected.items():
            # No run differs from another: the interval is the value itself.
            np.testing.assert_allclose(scores.tracking[name], value)
    # The truth is the same for both.
    ratio = compare(study, results["dead-reckoning"], results["kalman"])["tracking.east"]
    np.testing.assert_allclose(ratio, 1.0)


def test_without_a_world_nothing_is_watched(study):
    plain = replace(study, scenario=Scenario(study.scenario.rig, duration=6.0, dt=1.0))
    result = run_study(plain, {"kalman": Kalman()}, 2)["kalman"]
    assert result.runs.tracked.shape == (2, 0)
    assert not summarise(plain, result).settled.tracking
