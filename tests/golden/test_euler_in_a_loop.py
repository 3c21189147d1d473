"""What Euler's rule costs in a closed loop: milder than its error in one step suggests."""

import jax.numpy as jnp
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.kalman import Kalman
from kedge.sensors.tracking_error import TrackingError
from kedge.simulation.scenario import Scenario
from kedge.simulation.worlds.lane_keeping import LaneKeeping
from kedge.studies.study import Study
from kedge.studies.summary import summarise_study
from kedge.studies.trials import run_study
from kedge.vehicles.lateral_tracking import (
    AbstractLateral,
    LateralTracking,
    LinearLateralTracking,
)


class Euler(AbstractLateral):
    """The linear model by the rule that it is not discretised with."""

    def step(self, state, control, noise, dt):
        A, B = LinearLateralTracking().system()
        x = jnp.stack([jnp.asarray(field) for field in state])
        push = control.acceleration + noise.longitudinal
        inputs = (control.steering, control.curvature, noise.lateral, noise.yaw, push)
        u = jnp.stack([jnp.asarray(value) for value in inputs])
        return space(state).unflatten(x + dt * (A @ x + B @ u))


def test_the_lateral_velocity_suffers():
    """By 8 % in steps of 0.05 s, with gusts of the same standard deviation in each."""
    dt, ratio = 0.05, 1.08
    deviations = {"lateral_noise": 0.5, "yaw_noise": 0.2, "longitudinal_noise": 0.3}
    gusts = {name: std * dt**0.5 for name, std in deviations.items()}
    car = LateralTracking(**gusts)
    prior = Gaussian(car.start(), jnp.diag(jnp.array([0.1, 0.05, 0.5, 0.02, 0.5]) ** 2))
    rig = Rig(car, (Installation("camera", TrackingError(), rate=1 / dt),), prior)
    scenario = Scenario(rig, 30.0, dt, world=LaneKeeping(), feedback="filter")
    vehicles = {"kalman": LinearLateralTracking(**gusts), "euler": Euler(**gusts)}
    study = Study(scenario, burn_in=3.0, start="truth", vehicles=vehicles)
    results = run_study(study, dict.fromkeys(vehicles, Kalman()), 100, chunk=100)
    found = summarise_study(study, results)["euler"].all_steps.ratios
    assert found["lateral_velocity"].value - 1 == pytest.approx(ratio - 1, rel=0.1)
