"""Covariances that come with readings: units, and what drivers write for "unknown"."""

from pathlib import Path

import numpy as np
import pytest

import kedge
from kedge.config.problem import load_problem
from kedge.core.errors import DataError

RIG = """\
[vehicle]
model = "unicycle"
parameters = { speed_noise = 0.05, yaw_rate_noise = 0.02 }
[control]
source = "odometry"
[sensors.gnss]
model = "gnss"
parameters = { std = 0.3 }
SPREAD
[prior]
mean = { position = [0, 0], heading = 0 }
std = { position = 0.2, heading = 0.1 }
[output]
rate = 1
"""
COVARIANCE, STD = 'covariance = ["a", "b", "c"]', 'std = { position_x = "a", position_y = "c" }'
LARGEST = "1.7976931348623157e308"


def problem(folder: Path, spread: str, cells: str, unit: str, fix: str = "1.1,0.2"):
    (folder / "rig.toml").write_text(RIG.replace("SPREAD", spread))
    log = folder / "log"
    log.mkdir(exist_ok=True)
    (log / "log.toml").write_text(
        '[sources.odometry]\ncolumns = { speed = "m/s", yaw_rate = "rad/s" }\n[sources.gnss]\n'
        f'columns = {{ position_x = "m", position_y = "m", a = "{unit}", b = "{unit}", '
        f'c = "{unit}" }}\n'
    )
    (log / "odometry.csv").write_text("time,speed,yaw_rate\n0,1,0\n1,1,0\n2,1,0\n")
    (log / "gnss.csv").write_text(f"time,position_x,position_y,a,b,c\n1,{fix},{cells}\n")
    return load_problem(str(folder / "rig.toml"), str(log))


def after(folder: Path, *arguments: str):
    """Verdicts, and the belief at the end; all problems run one program."""
    loaded = problem(folder, *arguments)
    found = kedge.estimate(kedge.make_filter("extended"), loaded.rig, loaded.recording.log)
    sensor = np.asarray(loaded.recording.log.schedule.sensor)
    verdict = kedge.Verdict(int(np.asarray(found.outcome.verdict)[sensor == 0][0]))
    mean, cov = found.moments.mean, np.asarray(found.moments.cov)[-1]
    return verdict.name, np.array([*np.asarray(mean.position)[-1], *np.diag(cov)]), loaded.notes


def test_what_was_not_known_is_the_sensors_own(tmp_path):
    verdict, usual, _ = after(tmp_path, COVARIANCE, "0.09,0,0.09", "m^2")
    assert verdict == "FUSED"
    for spread, cells, unit in (
        (COVARIANCE, "0,0,0", "m^2"),
        (COVARIANCE, ",,", "m^2"),
        (STD, "0,,0", "m"),
        (STD, ",,0.3", "m"),
        (COVARIANCE, "90000,0,0", "mm^2"),
    ):
        verdict, found, notes = after(tmp_path, spread, cells, unit)
        assert verdict == "FUSED"
        np.testing.assert_allclose(found, usual, rtol=1e-12)
        assert "leave a variance open" in notes[-1]


def test_a_component_that_is_not_there_leaves_the_others(tmp_path):
    _, usual, _ = after(tmp_path, COVARIANCE, "0.04,0,0.09", "m^2", "1.1,")
    for cells in (f"0.04,0,{LARGEST}", "0.04,0,1e9", f"0.04,{LARGEST},{LARGEST}"):
        verdict, found, notes = after(tmp_path, COVARIANCE, cells, "m^2")
        assert verdict == "FUSED"
        np.testing.assert_allclose(found, usual, rtol=1e-12)
        assert "a component is not there" in notes[-1]


def test_a_reading_that_is_not_there_changes_nothing(tmp_path):
    _, nothing, _ = after(tmp_path, COVARIANCE, "0.04,0,0.09", "m^2", ",")
    for cells in ("-1,0,0", f"{LARGEST},0,{LARGEST}"):
        verdict, found, _ = after(tmp_path, COVARIANCE, cells, "m^2")
        assert verdict == "NOT_FINITE"
        np.testing.assert_array_equal(found, nothing)
    for cells in ("0.04,0.2,0.09", "-2,0,0.09", "0,0.01,0.09"):
        assert after(tmp_path, COVARIANCE, cells, "m^2")[0] == "BAD_COVARIANCE"
    assert after(tmp_path, STD, "-0.1,0,0.1", "m")[0] == "BAD_COVARIANCE"


@pytest.mark.parametrize("unit", ["m", "mm", "m/s", "rad^2", "1"])
def test_only_the_product_of_the_units_is_a_covariance(tmp_path, unit):
    with pytest.raises(DataError, match=r"column 'a': found unit .* expected 'm.2'") as caught:
        problem(tmp_path, COVARIANCE, "0.3,0,0.3", unit)
    assert ("deviations belong in std" in str(caught.value)) == (unit in ("m", "mm"))
