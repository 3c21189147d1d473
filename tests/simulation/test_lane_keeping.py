"""The car on its lane, where nothing blows: decay, the steady turn, and who knows the road."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.rig import Installation, Rig
from kedge.sensors.tracking_error import TrackingError
from kedge.simulation.routes import Lane
from kedge.simulation.scenario import History, Scenario
from kedge.simulation.simulate import simulate
from kedge.simulation.worlds.lane_keeping import LaneKeeping
from kedge.vehicles.lateral_tracking import LateralTracking

CALM = LateralTracking(lateral_noise=0.0, yaw_noise=0.0, longitudinal_noise=0.0)


def driven(vehicle, key, **parameters):
    rig = Rig(
        vehicle, (Installation("camera", TrackingError()),), Gaussian(CALM.start(), jnp.eye(5))
    )
    world = LaneKeeping(**parameters)
    scenario = Scenario(rig, 10.0, 0.02, world=world, feedback="truth")
    run = simulate(scenario, key)
    watched = world.watch(scenario, History(run.truth, run.controls, run.start))
    return run, np.asarray(watched)


def test_an_offset_decays_as_the_poles_say(key):
    """1 m: 0.15 m after 1 s, 0.03 m after 2 s, whatever the key."""
    run, _ = driven(CALM, key)
    offset = np.abs(np.asarray(run.truth.offset))
    assert float(run.start.offset) == 1.0
    assert round(offset[49], 2) == pytest.approx(0.15, abs=0.011)
    assert round(offset[99], 2) == pytest.approx(0.03, abs=0.011)


def test_in_a_long_curve_the_car_settles_in_the_steady_turn(key):
    road = Lane(begin=1.0, end=20.0)
    run, watched = driven(CALM, key, offset=0.0, route=road)
    assert abs(watched[-1, 0]) < 2e-3  # e_y: sin and cos of e_phi are not quite linear
    np.testing.assert_allclose(watched[-1, 1], 0.0168, atol=1e-4)
    np.testing.assert_allclose(run.truth.yaw_rate[-1], 40 / 800, rtol=1e-6)
    np.testing.assert_allclose(run.controls.curvature[-1], 1 / 800)


def test_a_curve_that_nobody_knows_leads_off_the_lane(key):
    road = Lane(begin=1.0, end=20.0)
    run, watched = driven(CALM, key, offset=0.0, route=road, curvature_known=False)
    np.testing.assert_array_equal(run.controls.curvature, 0.0)
    assert abs(watched[-1, 0]) > 0.3


def test_the_gusts_are_those_of_the_rigs_vehicle(key):
    """Held over a step of 0.02 s, 0.3 m/s^2 along the road: by the density and the step."""
    windy = LateralTracking(lateral_noise=0.0, yaw_noise=0.0)
    run, _ = driven(windy, key)
    speed = np.append(0.0, np.asarray(run.truth.speed_error))
    push = np.diff(speed) / 0.02 - np.asarray(run.controls.acceleration)
    pushed = push - np.asarray(run.truth.yaw_rate * run.truth.lateral_velocity)
    assert pushed.std() == pytest.approx(0.0424 / np.sqrt(0.02), rel=0.1)
