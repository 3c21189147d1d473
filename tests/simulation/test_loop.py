"""Closed loops: one filter, one set of readings, whoever listens."""

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
from kedge.estimation.rig import Installation, Rig
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.tracking_error import TrackingError
from kedge.simulation.loop import start_near
from kedge.simulation.scenario import LoopFilter, Scenario
from kedge.simulation.simulate import schedule, simulate, with_readings
from kedge.simulation.worlds.lane_keeping import LaneKeeping
from kedge.vehicles.constant_velocity import ConstantVelocity
from kedge.vehicles.lateral_tracking import LateralTracking

CAR = LateralTracking()
COV = jnp.diag(jnp.array([0.1, 0.05, 0.5, 0.02, 0.5]) ** 2)
# Two sensors, at the same times and apart: the order of what is heard matters.
SENSORS = (
    Installation("camera", TrackingError(), rate=25.0),
    Installation("second", TrackingError(offset_std=0.2), rate=50 / 3),
)
RIG = Rig(CAR, SENSORS, Gaussian(CAR.start(), COV))
SCENARIO = Scenario(RIG, duration=1.2, dt=0.02, world=LaneKeeping())


def in_a_loop(feedback, filter=None, key=None):
    pilot = None if filter is None else LoopFilter(filter, key=key, error=0.5 * jnp.ones(5))
    return dataclasses.replace(SCENARIO, feedback=feedback, loop_filter=pilot)


@pytest.mark.parametrize(
    "filter",
    [ExtendedKalman(), pytest.param(EnsembleKalman(count=6), marks=pytest.mark.slow)],
    ids=["extended", "ensemble"],
)
def test_the_filter_in_the_loop_is_the_one_that_runs_over_the_log(filter, key):
    """What it steered by is what a pass over the recorded readings finds."""
    scenario = in_a_loop("filter", filter, jr.key(9))
    run = simulate(scenario, key)
    plan = schedule(scenario, 1 / scenario.dt)
    prior = Gaussian(start_near(RIG.prior, run.start, 0.5 * jnp.ones(5)), COV)
    rig = eqx.tree_at(lambda r: r.prior, RIG, prior)
    found = estimate(filter, rig, with_readings(plan.log, scenario, run), jr.key(9))
    believed = jax.tree.map(lambda leaf: leaf[plan.outputs], found.moments.mean)
    times = np.arange(1, scenario.steps + 1) * scenario.dt
    steer = jax.jit(jax.vmap(LaneKeeping().guidance(scenario)))
    again = steer(believed, times)
    for told, commanded in zip(run.controls, again, strict=True):
        np.testing.assert_allclose(told[1:], commanded[:-1], rtol=1e-9, atol=1e-12)
    assert np.std(run.controls.steering) > 1e-3


def test_what_is_heard_changes_neither_gusts_nor_noise(key):
    """The noise of the readings, and the first step before anything was heard."""
    runs = {name: simulate(in_a_loop(name), key) for name in ("none", "truth", "readings")}
    noises = {}
    for name, run in runs.items():
        ticks = SCENARIO.ticks(SENSORS[1]) - 1
        noises[name] = run.readings[1].measurement.offset - run.truth.offset[ticks]
    np.testing.assert_allclose(noises["truth"], noises["none"], atol=1e-12)
    np.testing.assert_allclose(noises["readings"], noises["none"], atol=1e-12)
    offsets = {name: np.asarray(run.truth.offset) for name, run in runs.items()}
    assert abs(offsets["truth"][-1]) < 0.7  # from 1 m
    assert np.abs(offsets["readings"] - offsets["truth"]).max() > 1e-3
    np.testing.assert_array_equal(runs["none"].controls.steering, 0.0)  # a straight


def test_raw_readings_are_held_until_the_next(key):
    run = simulate(in_a_loop("readings"), key)
    camera, second = (readings.measurement.speed_error for readings in run.readings)
    # Accelerations are -0.5 1/s times what was last read: at steps 2, 3, 4 and 6 (both).
    wanted = -0.5 * np.array([0.0, 0.0, camera[0], second[0], camera[1], camera[1], second[1]])
    np.testing.assert_allclose(run.controls.acceleration[:7], wanted, rtol=1e-9)


def test_refusals(key):
    plain = Rig(ConstantVelocity(), (), Gaussian(ConstantVelocity().start(), jnp.eye(4)))
    with pytest.raises(ContractError, match=r"no feedback called 'thruth' .*mean 'truth'"):
        dataclasses.replace(SCENARIO, feedback="thruth")
    with pytest.raises(ContractError, match="nothing is steered here"):
        Scenario(plain, feedback="truth")
    with pytest.raises(ContractError, match="none is named"):
        simulate(in_a_loop("filter"), key)
    with pytest.raises(ContractError, match="a ConstantVelocity cannot keep a lane"):
        simulate(Scenario(plain, duration=1.0, world=LaneKeeping()), key)
