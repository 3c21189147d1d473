"""Faults that concern some of the targets on a sensor's map."""

import jax.random as jr
import numpy as np
import pytest

from kedge.config.scenarios import load_scenario
from kedge.core.errors import ConfigError
from kedge.simulation.fault_kinds import Dropout
from kedge.simulation.faults import Fault, drawn

TIMES = np.arange(12) / 10.0
TARGETS = np.arange(12) % 3


def test_only_what_is_read_of_these_targets_is_lost():
    fault = Fault("shelf", "radio", Dropout(), ((0.2, 0.9),), targets=(1, 2))
    (drawn_fault,) = drawn((fault,), "radio", TIMES, TARGETS, 1, jr.key(0))
    lost = np.asarray(drawn_fault.drawn)[:, 0]
    inside = (TIMES >= 0.2) & (TIMES < 0.9)
    np.testing.assert_array_equal(lost, inside & (TARGETS > 0))


def test_a_file_names_them_by_their_ids():
    (blocked,) = (
        fault for fault in load_scenario("uwb-imu-agv").scenario.faults if fault.targets
    )
    assert (blocked.name, blocked.targets) == ("blocked", (0, 1))
    with pytest.raises(ConfigError, match=r"faults\.blocked\.targets: found \['9'\]"):
        load_scenario("uwb-imu-agv", {"faults.blocked.targets": '["9"]'})
    changes = {"faults.outage.on": "wheels", "faults.outage.targets": '["1"]'}
    with pytest.raises(ConfigError, match=r"found \['1'\], expected no targets"):
        load_scenario("uwb-imu-agv", changes)
