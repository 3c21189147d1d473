"""The slipping robot: what must hold exactly without slip, and the statistics of its errors."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.estimation.batch import estimate
from kedge.estimation.rig import Installation, Rig, as_arrays
from kedge.filters.gaussian.dead_reckoning import DeadReckoning
from kedge.sensors.landmark_pose import Landmark, LandmarkPose
from kedge.simulation.routes import AbstractRoute, Circle, Facing, Place, Waypoints
from kedge.simulation.scenario import History, Scenario
from kedge.simulation.simulate import schedule, simulate, with_readings
from kedge.simulation.worlds.omni_robot import OmniRobot
from kedge.vehicles.omnidirectional import Omnidirectional, State

LANDMARK = (1.0, 0.0)
SQUARE = ((0.0, 0.0), (0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0), (0.0, 0.0))
ROUTES = {
    "circle": Facing(Circle(LANDMARK), LANDMARK),
    "square": Facing(Waypoints(SQUARE, 0.2), LANDMARK),
}
DT = 0.01


def lap(name="circle", duration=40.0, world=None, **parameters):
    robot = Omnidirectional()
    camera = Installation("camera", LandmarkPose(), rate=10.0)
    rig = Rig(robot, (camera,), Gaussian(robot.start(), jnp.eye(3)))
    world = OmniRobot(ROUTES[name], **parameters) if world is None else world
    return Scenario(rig, duration, DT, world=world)


@eqx.filter_jit
def losses(world, keys):
    return jax.vmap(lambda key: 1 - world.grips(key, 4000, DT))(keys)


def lost(key, **parameters):
    """The share that each wheel loses in each step, in runs of 40 s."""
    world = as_arrays(OmniRobot(ROUTES["circle"], **parameters))
    return np.asarray(losses(world, jr.split(key, 50)))


def astray(scenario, run):
    """How far the robot is from its route in m, and its heading in rad."""
    assert scenario.world is not None
    history = History(run.truth, run.controls, run.start)
    return np.asarray(scenario.world.watch(scenario, history))


@pytest.mark.parametrize("name", ROUTES)
def test_without_slip_the_robot_is_on_its_route(name, key):
    scenario = lap(name, slip=0.0)
    # Not to rounding: a command is held for 20 ms, in which the route bends.
    np.testing.assert_allclose(astray(scenario, simulate(scenario, key)), 0, atol=1e-5)


def test_slip_leads_off_the_route_and_encoders_do_not(key):
    away = {}
    for delay in (0.02, 0.3):
        scenario = lap(delay=delay)
        away[delay] = astray(scenario, simulate(scenario, key))
    assert 0.02 < away[0.02][:, 0].max() < 1
    assert 0.01 < np.abs(away[0.02][:, 1]).max() < 1
    np.testing.assert_allclose(away[0.02], away[0.3], atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.07])
def test_counts_are_the_wheels_angle_when_they_were_taken(delay, key):
    """On the circle wheel i turns at (-v cos(alpha_i) + R omega) / r throughout."""
    run = simulate(lap(duration=4.0, slip=0.0, delay=delay), key)
    turning = 2 * np.pi / 40
    rates = turning * (np.array([-1, 0, 1, 0]) + 0.2) / 0.05
    told = np.cumsum(np.asarray(run.controls.wheels) * DT, axis=0)[1::2]
    read = np.arange(1, 201) * 0.02
    angle = rates * np.maximum(read - delay, 0)[:, None]
    assert np.abs(told - angle).max() < 2 * np.pi / 2048
    assert np.abs(told - angle).max() > 0.3 * 2 * np.pi / 2048


class Turnback(AbstractRoute):
    """Forward until a time, then back."""

    until: float = eqx.field(static=True)

    def at(self, time):
        way = jnp.minimum(time, 2 * self.until - time)
        none = jnp.zeros(())
        speed = jnp.where(time < self.until, 1.0, -1.0)
        return Place(jnp.stack([way, none]), jnp.stack([speed, none]), none, none)


def test_filters_are_told_nothing_of_what_is_still_to_come(key):
    """With a delay of one reading: counts that are past at the time from which they hold."""
    world = OmniRobot(Turnback(100.0))
    other = OmniRobot(Turnback(1.0))
    told = [
        np.asarray(simulate(lap(duration=2.0, world=w), key).controls.wheels)
        for w in (world, other)
    ]
    np.testing.assert_array_equal(told[0][:102], told[1][:102])
    # The second and the fourth wheel drive along the first axis.
    assert (told[0][102:, 1] < 0).all()
    assert (told[1][102:, 1] > 0).all()


def test_dead_reckoning_by_perfect_encoders_is_the_truth(key):
    """So every control holds over the time in which it was counted."""
    scenario = lap("square", 8.0, slip=0.0, delay=0.0, counts=1e9)
    run = simulate(scenario, key)
    plan = schedule(scenario, output_rate=50.0)
    found = estimate(DeadReckoning(), scenario.rig, with_readings(plan.log, scenario, run))
    every = np.asarray(found.moments.mean.position)[plan.outputs]
    # Over 20 ms the midpoint rule errs by as much as the corners of a polygon do.
    np.testing.assert_allclose(every, np.asarray(run.truth.position)[1::2], atol=1e-5)


def test_missed_counts_are_the_given_share(key):
    """What is left of every count with the probability 0.95, whatever the direction."""
    told = {
        missed: np.asarray(simulate(lap(slip=0.0, missed=missed), key).controls.wheels)
        for missed in (0.0, 0.05)
    }
    assert (np.abs(told[0.05]) <= np.abs(told[0.0]) + 1e-12).all()
    # Some 49,000 counts of the first wheel, backwards, and 73,000 of the third.
    for wheel in (0, 2):
        counts = np.abs(told[0.0][:, wheel]).sum() * DT * 2048 / (2 * np.pi)
        share = 1 - told[0.05][:, wheel].sum() / told[0.0][:, wheel].sum()
        assert abs(share - 0.05) < 4 * np.sqrt(0.05 * 0.95 / counts)


def test_what_a_wheel_loses_all_the_time(key):
    bias = lost(key, white_std=0.0, event_rate=0.0)
    assert np.ptp(bias, axis=1).max() < 1e-12
    np.testing.assert_allclose(bias[:, 0].std(), 0.01, rtol=0.2)
    white = lost(key, bias_std=0.0, event_rate=0.0)
    averaged = white.reshape(50, 2000, 2, 4).mean(axis=2)
    np.testing.assert_allclose(averaged.std(), 0.02, rtol=0.01)
    tripled = lost(key, bias_std=0.0, event_rate=0.0, slip=3.0)
    np.testing.assert_allclose(tripled, 3 * white, atol=1e-12)


def test_slip_events_are_as_many_as_long_and_as_bad_as_told(key):
    """A new event ends the one before: a wheel slips for the share r d / (1 + r d)."""
    slips = lost(key, bias_std=0.0, white_std=0.0, event_rate=0.5, event_duration=0.4)
    share = 0.5 * 0.4 / (1 + 0.5 * 0.4)
    # 50 runs of 4 wheels with 20 events each.
    np.testing.assert_allclose(slips.mean(), share * 0.55, rtol=0.05)
    np.testing.assert_allclose((slips > 0).mean(), share, rtol=0.05)
    assert slips.max() <= 0.8
    assert np.median(slips[slips > 0]) == pytest.approx(0.55, abs=0.02)
    begins = ((slips[:, 1:] > 0) & (slips[:, :-1] == 0)).sum() / (50 * 4 * 40)
    assert begins == pytest.approx(0.5 * (1 - share), rel=0.05)


def test_a_fix_undoes_the_sensor():
    """Landmarks anywhere, turned anyhow: what is seen of one tells where it is seen from."""
    camera = LandmarkPose(
        Landmark(jnp.array([[1.0, 0.0], [-3.0, 2.0]]), jnp.array([0.0, 2.5])),
    )
    installation, world = Installation("camera", camera), OmniRobot(ROUTES["circle"])
    for x, y, heading in ((0.2, -0.7, 3.1), (-5.0, 2.0, -1.2)):
        pose = State(jnp.array([x, y]), jnp.array(heading))
        for target in (0, 1):
            number = jnp.asarray(target)
            seen = installation.expect(pose, number)
            found = world.fix(installation, number, seen)
            np.testing.assert_allclose(found["position"], [x, y], atol=1e-12)
            np.testing.assert_allclose(found["heading"], heading, atol=1e-12)


def test_feedback_leads_back_to_the_route(key):
    """The same slip, steered by nothing and by the truth."""
    away = {}
    for feedback in ("none", "truth"):
        scenario = dataclasses.replace(lap(), feedback=feedback)
        away[feedback] = astray(scenario, simulate(scenario, key))
    open_loop, closed = (np.sqrt(np.mean(one[:, 0] ** 2)) for one in away.values())
    assert open_loop > 0.03
    assert closed < 0.015


def test_encoders_that_do_not_fit_the_steps_are_refused():
    with pytest.raises(ContractError, match="encoder_rate is 30 Hz, expected a whole number"):
        schedule(lap(encoder_rate=30.0))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"delay": -0.1}, r"delay is -0\.1 s, expected 0 or more"),
        ({"missed": 1.5}, r"missed is 1\.5, expected a share"),
        ({"radius": 0.0}, r"radius is 0\.0, expected above 0"),
    ],
)
def test_robots_that_cannot_be(given, message):
    with pytest.raises(ContractError, match=message):
        OmniRobot(ROUTES["circle"], **given)
