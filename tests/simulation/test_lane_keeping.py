"""The car on its lane, where nothing blows: decay, the steady turn, and who knows the road."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.estimation.rig import Installation, Rig, as_arrays
from kedge.sensors.tracking_error import TrackingError
from kedge.simulation.routes import Lane, Rectangle
from kedge.simulation.scenario import History, Scenario
from kedge.simulation.simulate import simulate
from kedge.simulation.worlds.guided_point import GuidedPoint
from kedge.simulation.worlds.lane_keeping import LaneKeeping
from kedge.vehicles.augmented import Drift, augment
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


LOADED = LateralTracking(mass=2250.0, lateral_noise=0.0, yaw_noise=0.0, longitudinal_noise=0.0)


def payload(key, since, vehicle=CALM):
    mean = vehicle.start()
    rig = Rig(
        vehicle, (Installation("camera", TrackingError()),),
        Gaussian(mean, jnp.eye(space(mean).size)),
    )  # fmt: skip
    world, road = LaneKeeping, Lane(begin=1.0, end=20.0)
    scenario = Scenario(
        rig, 10.0, 0.02, world=world(offset=0.0, route=road), feedback="truth",
        true_vehicle=LOADED, true_from=since,
    )  # fmt: skip
    return simulate(as_arrays(scenario), key).truth


def test_the_true_car_is_another_from_a_time_on(key):
    """In a steady turn a heavier car needs more slip; before, it is the car as known."""
    light, _ = driven(CALM, key, offset=0.0, route=Lane(begin=1.0, end=20.0))
    heavy, later = payload(key, 0.0), payload(key, 5.0)
    np.testing.assert_allclose(later.offset[:250], light.truth.offset[:250], atol=1e-12)
    assert abs(later.offset[-1] - light.truth.offset[-1]) > 0.02
    # Half a turn of the poles later, how the car came to be heavy is forgotten.
    np.testing.assert_allclose(later.offset[-1], heavy.offset[-1], atol=1e-3)


def test_an_estimated_mass_is_truly_that_of_the_true_car(key):
    vehicle = augment(CALM, {"mass": Drift()}, [])
    mass = np.asarray(payload(key, 5.0, vehicle).mass)
    np.testing.assert_array_equal(mass[:249], 1500.0)
    np.testing.assert_array_equal(mass[250:], 2250.0)


def test_a_world_with_a_vehicle_of_its_own_refuses_a_true_one():
    rig = Rig(CALM, (), Gaussian(CALM.start(), jnp.eye(5)))
    with pytest.raises(ContractError, match=r"true_parameters: the world moves a vehicle of"):
        Scenario(rig, 10.0, 0.02, world=GuidedPoint(Rectangle()), true_vehicle=LOADED)


def test_the_rigs_own_drive_is_that_of_the_true_vehicle(key):
    """Without a world: from one start, under the nominal steering, by the true parameters."""
    rig = Rig(CALM, (), Gaussian(CALM.start(), 1e-18 * jnp.eye(5)))
    known = Scenario(rig, 4.0, 0.02)
    paths = [
        simulate(as_arrays(scenario), key).truth.yaw_rate
        for scenario in (
            known,
            dataclasses.replace(known, true_vehicle=LOADED, true_from=2.0),
            Scenario(Rig(LOADED, (), rig.prior), 4.0, 0.02),
            dataclasses.replace(known, true_vehicle=LOADED),
        )
    ]
    light, later, heavy, true = map(np.asarray, paths)
    np.testing.assert_array_equal(later[:100], light[:100])
    assert abs(later[-1] - light[-1]) > 1e-4
    np.testing.assert_allclose(true, heavy, rtol=1e-12)
