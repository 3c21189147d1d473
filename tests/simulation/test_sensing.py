"""Simulated sensors: all targets at once, and a noise that filters do not know."""

import jax
import numpy as np
import pytest

from kedge.config.scenarios import load_scenario
from kedge.core.errors import ConfigError, ContractError
from kedge.core.manifolds import space_of
from kedge.simulation.simulate import record, simulate

SCENARIO = """
[scenario]
title = "a tag that stands"
source = "these tests"
duration = 40.0
dt = 0.5
filters = ["extended"]
[vehicle]
model = "still"
parameters = { walk = 0.0 }
[sensors.radio]
model = "squared-ranges"
rate = 1.0
map = "anchors"
parameters = { range_std = 0.1 }
[maps.anchors]
ids = ["a", "b", "c"]
columns = { position_x = [0, 30, 0], position_y = [0, 0, 20] }
[prior]
mean = { position = [10.0, 5.0] }
std = { position = 1e-9 }
"""
FAR = np.hypot([10.0, 20.0, 10.0], [5.0, 5.0, 15.0])


def recorded(tmp_path, **changes):
    path = tmp_path / "own.toml"
    path.write_text(SCENARIO)
    scenario = load_scenario(str(path), changes).scenario
    recording, _ = record(scenario, jax.random.key(0))
    return recording.log, scenario.rig.sensors[0]


def test_a_sweep_reads_every_target_each_time(tmp_path):
    log, _ = recorded(tmp_path, **{"sensors.radio.all_targets": "true"})
    radio = np.asarray(log.schedule.sensor) == 0
    times = np.asarray(log.schedule.time)[radio].reshape(-1, 3)
    np.testing.assert_allclose(times, np.arange(1.0, 41.0)[:, None] * np.ones(3))
    np.testing.assert_array_equal(log.readings[0].target, np.tile([0, 1, 2], 40))
    found = np.sqrt(np.asarray(log.readings[0].measurement.squared_range)).reshape(-1, 3)
    np.testing.assert_allclose(found.mean(axis=0), FAR, atol=4 * 0.1 / 40**0.5)
    assert (found[1:] != found[:-1]).all()  # each with a noise of its own


def test_one_after_the_other_without_it(tmp_path):
    log, _ = recorded(tmp_path)
    assert len(log.readings[0].target) == 40


def test_what_a_sensor_really_is_filters_do_not_know(tmp_path):
    """Filters take it for one of 100 m^2; it scatters by 2 d 0.1 m."""
    believed = {"sensors.radio.parameters": "{ range_std = 0.1, squared_std = 100.0 }"}
    log, installed = recorded(
        tmp_path, **believed, **{"sensors.radio.true_parameters": "{ squared_std = 0.0 }"}
    )
    spread = np.asarray(log.readings[0].measurement.squared_range)[::3].std()
    assert spread == pytest.approx(2 * FAR[0] * 0.1, rel=0.6)
    assert float(installed.sensor.squared_std) == 100.0


def test_a_sweep_without_targets_is_refused(tmp_path):
    changes = {"sensors.radio.model": '"gnss"', "sensors.radio.all_targets": "true"}
    path = tmp_path / "own.toml"
    path.write_text(
        SCENARIO.replace('map = "anchors"\n', "").replace("{ range_std = 0.1 }", "{}")
    )
    with pytest.raises(ContractError, match="no map"):
        load_scenario(str(path), changes)


def test_an_unknown_parameter_of_what_it_really_is(tmp_path):
    with pytest.raises(ConfigError, match=r"true_parameters\.colour"):
        recorded(tmp_path, **{"sensors.radio.true_parameters": "{ colour = 1.0 }"})


@pytest.mark.parametrize("treatment", ["estimated", "considered", "widened"])
def test_errors_with_a_memory_are_in_the_readings(tmp_path, treatment):
    """Of a tag that stands: their spread, and their correlation after a second."""
    flag = "" if treatment == "estimated" else f", {treatment} = true"
    error = "{ std = 50.0, time_constant = 2.0" + flag + " }"
    changes = {"sensors.radio.all_targets": "true", "sensors.radio.error": error}
    log, _ = recorded(tmp_path, **{"scenario.duration": "3000.0"} | changes)
    readings = log.readings[0]
    for target in range(3):
        square = np.asarray(readings.measurement.squared_range)
        off = square[np.asarray(readings.target) == target] - FAR[target] ** 2
        assert np.std(off) == pytest.approx(50.0, rel=0.1)
        correlation = np.mean(off[1:] * off[:-1]) / np.mean(off**2)
        assert correlation == pytest.approx(np.exp(-0.5), abs=0.06)


def test_errors_with_a_memory_are_drawn_for_a_world_that_knows_nothing_of_them():
    error = {"sensors.camera.error": "{ std = 0.01, time_constant = 5.0, by_target = false }"}
    plain = load_scenario("omni-circle").scenario
    scenario = load_scenario("omni-circle", error).scenario
    run, without = (simulate(s, jax.random.key(1)) for s in (scenario, plain))
    (camera,) = (n for n, s in enumerate(scenario.rig.sensors) if s.name == "camera")
    step = scenario.ticks(scenario.rig.sensors[camera]) - 1
    outputs = space_of(scenario.rig.sensors[camera].sensor.measures)
    noisy, clean = (r.readings[camera].measurement for r in (run, without))
    off = jax.vmap(outputs.boxminus)(noisy, clean)
    names = [name for name in run.truth._fields if name.startswith("error_of_camera_")]
    errors = np.concatenate([getattr(run.truth, name)[step] for name in names], axis=1)
    np.testing.assert_allclose(off, errors, atol=1e-9)
    assert np.std(errors) == pytest.approx(0.01, rel=0.5)
