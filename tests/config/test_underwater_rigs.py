"""The rigs for underwater vehicles on a log."""

import numpy as np
import pytest

import kedge
from kedge.config.filters import build_filter
from kedge.config.problem import load_problem
from kedge.core.verdicts import Verdict


@pytest.mark.slow
def test_a_log_may_begin_deep(tmp_path):
    """At 80 m: the first reading of the pressure says so, and no gate refuses it."""
    (tmp_path / "log").mkdir()
    units = '[sources.depth]\ncolumns = { depth = "m" }\n'
    (tmp_path / "log" / "log.toml").write_text(units)
    off = 0.05 * np.random.default_rng(1).normal(size=20)
    rows = [f"{0.2 * i:.1f},{80 + off[i]:.4f}" for i in range(20)]
    (tmp_path / "log" / "depth.csv").write_text("\n".join(["time,depth", *rows]) + "\n")
    (tmp_path / "rig.toml").write_text(
        'extends = "auv_navigation"\nwithout = ["sensors.dvl", "sensors.ahrs", "sensors.gyro", '
        '"vehicle.augmented"]\n'
    )
    problem = load_problem(str(tmp_path / "rig.toml"), str(tmp_path / "log"))
    log = problem.recording.log
    found = kedge.estimate(build_filter("extended"), problem.rig, log)
    sensed = np.asarray(log.schedule.sensor) >= 0
    assert (np.asarray(found.outcome.verdict)[sensed] == Verdict.FUSED).all()
    assert found.moments.mean.position[sensed][0, 2] == pytest.approx(-80 - off[0], abs=1e-3)
    assert found.moments.mean.position[-1, 2] == pytest.approx(-80, abs=0.1)
