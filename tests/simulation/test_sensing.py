"""Simulated sensors: all targets at once, and a noise that filters do not know."""

import jax
import numpy as np
import pytest

from kedge.config.scenarios import load_scenario
from kedge.core.errors import ConfigError, ContractError
from kedge.simulation.simulate import record

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
