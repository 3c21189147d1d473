"""Faults: each against what it is said to do, and none against anything else."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.manifolds import space_of
from kedge.estimation.rig import Installation, Rig
from kedge.sensors.gnss import Gnss
from kedge.sensors.position_velocity import PositionVelocity
from kedge.simulation.fault_kinds import (
    Bias,
    Clock,
    Delay,
    Drift,
    Dropout,
    Duplicate,
    Jitter,
    NotANumber,
    Outliers,
    OutOfOrder,
    Quantisation,
    Stuck,
)
from kedge.simulation.faults import Episodes, Fault, validation_error
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import simulate
from kedge.simulation.worlds.lane_keeping import LaneKeeping
from kedge.vehicles.constant_velocity import ConstantVelocity, State
from kedge.vehicles.unicycle import Unicycle

VELOCITY = np.array([2.0, -1.0])
CAR = ConstantVelocity(acceleration_noise=0.0)
SENSORS = (
    Installation("gps", PositionVelocity(position_std=0.5, velocity_std=0.05), rate=10.0),
    Installation("second", PositionVelocity(), rate=5.0),
)
START = Gaussian(State(jnp.zeros(2), jnp.asarray(VELOCITY)), 1e-18 * jnp.eye(4))
SCENARIO = Scenario(Rig(CAR, SENSORS, START), duration=40.0, dt=0.1)
TIMES = SCENARIO.times(SENSORS[0])


@functools.cache
def plain():
    return simulate(SCENARIO, jr.key(3))


def with_fault(kind, windows=(), episodes=None, on="gps"):
    fault = Fault("what goes wrong", on, kind, windows, episodes)
    return simulate(dataclasses.replace(SCENARIO, faults=(fault,)), jr.key(3))


def gps(run):
    return np.hstack(jax.tree.map(np.asarray, run.readings[0].measurement))


def extra(run):
    """What the fault adds to the readings, after what it must not touch was compared."""
    for mine, without in (
        (run.truth, plain().truth),
        (run.readings[1].measurement, plain().readings[1].measurement),
    ):
        for leaf, other in zip(mine, without, strict=True):
            np.testing.assert_array_equal(leaf, other)
    return gps(run) - gps(plain())


def inside(begin, end):
    return (begin <= TIMES) & (end > TIMES)


def test_a_dropout_takes_whole_readings_and_its_share_of_them():
    lost = np.isnan(extra(with_fault(Dropout(0.3), windows=((0.0, 30.0),))))
    assert (lost.all(axis=1) == lost.any(axis=1)).all()
    assert not lost[TIMES >= 30.0].any()
    share = lost[inside(0.0, 30.0), 0].mean()
    assert abs(share - 0.3) < 4 * np.sqrt(0.3 * 0.7 / 299)
    outage = np.isnan(extra(with_fault(Dropout(), windows=((10.0, 12.0), (20.0, 21.0)))))
    np.testing.assert_array_equal(outage[:, 0], inside(10.0, 12.0) | inside(20.0, 21.0))


def test_components_are_no_numbers_one_by_one():
    bad = np.isnan(extra(with_fault(NotANumber(0.2, component="position"))))
    assert not bad[:, 2:].any()
    assert abs(bad[:, :2].mean() - 0.2) < 4 * np.sqrt(0.2 * 0.8 / 800)
    both = (bad[:, 0] & bad[:, 1]).mean()
    assert abs(both - 0.04) < 4 * np.sqrt(0.04 * 0.96 / 400)


def test_a_bias_is_constant_in_its_component_and_window():
    added = extra(with_fault(Bias(0.7, component="position_y"), windows=((5.0, 9.0),)))
    np.testing.assert_allclose(added[:, 1], 0.7 * inside(5.0, 9.0), atol=1e-12)
    np.testing.assert_allclose(added[:, [0, 2, 3]], 0.0, atol=1e-12)  # other fused sums
    drawn = extra(with_fault(Bias(std=2.0)))
    np.testing.assert_allclose(drawn, np.broadcast_to(drawn[0], drawn.shape), atol=1e-12)
    assert len(np.unique(np.round(drawn[0], 9))) == 4


def test_a_drift_grows_from_where_it_begins():
    added = extra(with_fault(Drift(0.2), windows=((10.0, 30.0),)))
    wanted = np.where(inside(10.0, 30.0), 0.2 * (TIMES - 10.0), 0.0)
    np.testing.assert_allclose(added, np.repeat(wanted[:, None], 4, axis=1), atol=1e-12)


def test_outliers_are_as_large_and_as_many_as_is_said():
    added = extra(with_fault(Outliers(0.25, 8.0))) / np.array([0.5, 0.5, 0.05, 0.05])
    hit = (np.abs(added) > 1e-9).any(axis=1)  # a sum is rounded, so 0 is not quite 0
    assert abs(hit.mean() - 0.25) < 4 * np.sqrt(0.25 * 0.75 / 400)
    # The sample variance of n normals errs by sqrt(2 / n).
    size = hit.sum() * 4
    assert abs(np.mean(added[hit] ** 2) / 64 - 1) < 4 * np.sqrt(2 / size)


def test_episodes_are_there_as_often_as_their_process_says():
    """Rate r, length d: the age of the latest beginning against the length of the episode."""
    rate, duration, runs = 0.5, 1.5, 4000
    fault = Fault("bursts", "gps", Outliers(1.0), (), Episodes(rate, duration))
    when = jax.vmap(lambda key: fault.when(key, TIMES))(jr.split(jr.key(0), runs))
    product = rate * duration
    wanted = product / (1 + product) * -np.expm1(-(rate + 1 / duration) * TIMES)
    share = np.mean(when.active, axis=0)
    assert np.all(np.abs(share - wanted) < 5 * np.sqrt(0.25 / runs))
    # Of those that are there, the age is exponential with the rate r + 1/d.
    late = np.asarray(when.since)[:, -1][np.asarray(when.active)[:, -1]]
    assert abs(late.mean() * (rate + 1 / duration) - 1) < 5 / np.sqrt(len(late))


def test_a_stuck_sensor_repeats_what_it_read_last():
    run = with_fault(Stuck(), windows=((0.0, 1.0), (10.0, 12.0)))
    extra(run)
    found, free = gps(run), gps(plain())
    stuck = inside(10.0, 12.0)
    np.testing.assert_array_equal(
        found[stuck], np.broadcast_to(free[TIMES < 10.0][-1], (20, 4))
    )
    np.testing.assert_array_equal(found[TIMES < 1.0], np.broadcast_to(free[0], (9, 4)))
    rest = ~stuck & (TIMES >= 1.0)
    np.testing.assert_array_equal(found[rest], free[rest])


@pytest.mark.parametrize("delay", [0.3, 0.137])
def test_a_delayed_reading_tells_of_an_earlier_time(delay):
    """The truth moves straight, so its position then is that now less the way since."""
    added = extra(with_fault(Delay(delay)))
    way = np.minimum(delay, TIMES)[:, None] * VELOCITY[None]  # before time 0 it stood
    np.testing.assert_allclose(added[:, :2], -way, atol=1e-9)
    np.testing.assert_allclose(added[:, 2:], 0.0, atol=1e-9)


def test_jitter_is_normal_in_time():
    added = extra(with_fault(Jitter(0.02)))[:-2]
    early = added[:, 0] / VELOCITY[0]
    np.testing.assert_allclose(added[:, 1] / VELOCITY[1], early, atol=1e-9)
    assert abs(early.mean()) < 4 * 0.02 / np.sqrt(len(early))
    assert abs(early.std() / 0.02 - 1) < 4 / np.sqrt(2 * len(early))


def test_a_clock_shows_what_its_law_says():
    clock = Clock(offset=0.2, drift=0.01, jump=-0.5, jump_at=20.0)
    added = extra(with_fault(clock))
    true = TIMES + added[:, 0] / VELOCITY[0]
    shown = true + 0.2 + 0.01 * true - 0.5 * (TIMES >= 20.0)
    here = (true > 1e-9) & (true < 39.99)  # the truth is known from 0 to 40 s
    assert here.sum() > 380
    np.testing.assert_allclose(shown[here], TIMES[here], atol=1e-9)


def test_quantised_readings_are_the_nearest_whole_steps():
    run = with_fault(Quantisation(0.25, component="position"))
    moved, found = extra(run), gps(run)[:, :2] / 0.25
    np.testing.assert_allclose(found, np.round(found), atol=1e-9)
    assert 0.12 < np.abs(moved[:, :2]).max() <= 0.125 + 1e-12
    np.testing.assert_allclose(moved[:, 2:], 0.0, atol=1e-15)


def test_another_fault_changes_no_draw():
    one = Fault("gaps", "gps", Dropout(0.3))
    noisy = Fault("jumps", "gps", Outliers(0.5))
    runs = [
        simulate(dataclasses.replace(SCENARIO, faults=faults), jr.key(3))
        for faults in ((one,), (noisy, one), (one, noisy))
    ]
    gaps = [np.isnan(gps(run)) for run in runs]
    np.testing.assert_array_equal(gaps[0], gaps[1])
    np.testing.assert_array_equal(gps(runs[1]), gps(runs[2]))


def test_two_faults_of_a_kind_are_drawn_apart():
    both = tuple(Fault(name, "gps", Bias(std=1.0)) for name in ("one", "two"))
    one, two = (
        gps(simulate(dataclasses.replace(SCENARIO, faults=(fault,)), jr.key(3)))
        for fault in both
    )
    assert abs((one - two)[0]).min() > 1e-3


def test_what_is_told_of_the_control():
    car = Unicycle()
    rig = Rig(car, (), Gaussian(car.start(), 1e-18 * jnp.eye(3)))
    scenario = Scenario(rig, duration=5.0, dt=0.1)
    free = simulate(scenario, jr.key(1))
    faults = (
        Fault("scale", "control", Bias(0.1, component="speed")),
        Fault("gap", "control", Dropout(), ((2.0, 3.0),)),
    )
    run = simulate(dataclasses.replace(scenario, faults=faults), jr.key(1))
    np.testing.assert_array_equal(run.truth.position, free.truth.position)
    wanted = np.asarray(free.controls.speed) + 0.1
    wanted[20:30] = wanted[19]
    np.testing.assert_allclose(run.controls.speed, wanted, atol=1e-12)
    slow = (Fault("late", "control", Delay(0.3)),)
    late = simulate(dataclasses.replace(scenario, faults=slow), jr.key(1)).controls
    np.testing.assert_array_equal(late.yaw_rate[3:], free.controls.yaw_rate[:-3])


def refused(kind, on="gps", windows=()):
    return lambda: dataclasses.replace(
        SCENARIO, faults=(Fault("it", on, kind, windows),), feedback="none"
    )


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (refused(Dropout(), on="gsp"), r"no sensor called 'gsp' \(did you mean 'gps'"),
        (refused(Dropout(), on="control"), "nothing is told of a control here"),
        (refused(Bias(component="positon")), r"'positon' \(did you mean 'position'"),
        (refused(Dropout(), windows=((3.0, 3.0),)), "found 3 to 3 s, expected the earlier"),
        (lambda: Dropout(1.5), r"probability is 1\.5, expected 0 to 1"),
        (lambda: Outliers(scale=-1.0), "scale is -1, expected 0 or more"),
        (lambda: Quantisation(0.0), "step is 0, expected above 0"),
        (lambda: Clock(drift=-1.0), "drift is -1, expected above -1"),
        (lambda: Delay(-0.1), r"delay is -0\.1, expected 0 or more"),
        (lambda: OutOfOrder(probability=2.0), "probability is 2, expected 0 to 1"),
        (lambda: Duplicate(after=-1.0), "after is -1, expected 0 or more"),
    ],
)
def test_refusals(build, message):
    with pytest.raises(ContractError, match=message):
        build()


def test_two_of_one_name_and_what_a_loop_cannot_have():
    twice = (Fault("it", "gps", Dropout()), Fault("it", "second", Dropout()))
    with pytest.raises(ContractError, match="two faults are called 'it'"):
        dataclasses.replace(SCENARIO, faults=twice)
    late = (Fault("late", "gps", Delay()),)
    looped = dataclasses.replace(SCENARIO, world=LaneKeeping(), feedback="truth", faults=late)
    with pytest.raises(ContractError, match=r"faults\.late: a guidance that hears readings"):
        dataclasses.replace(looped, feedback="readings")


def test_a_sensor_of_one_component_is_chosen_by_its_field():
    fault = Fault("it", "gps", Bias(component="position"))
    assert validation_error(fault, {"gps": space_of(Gnss.measures)}) is None
