"""Covariances that come with readings: units, and what drivers write for "unknown"."""

from pathlib import Path

import numpy as np
import pytest

import kedge
from kedge.config.covariances import read_covariances
from kedge.config.problem import load_problem
from kedge.config.rigs import SensorConfig
from kedge.core.errors import DataError
from kedge.core.manifolds import space_of
from kedge.formats.logs import write_log
from kedge.formats.readers import read_log

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


@pytest.mark.parametrize("model", ["gnss", "gnss3", "pose"])
def test_covariances_of_ned_are_turned_as_their_readings_are(model, tmp_path):
    """The covariance of readings in NED comes out as that of the same readings in ENU."""
    cls = kedge.make_sensor(model).measures
    labels, units = space_of(cls).labels, space_of(cls).units
    mixed = np.random.default_rng(0).normal(size=(3, 3))[: len(labels), : len(labels)]
    noise = 0.1 * np.random.default_rng(1).normal(size=(50, len(labels))) @ mixed
    above = list(zip(*np.triu_indices(len(labels)), strict=True))
    names = [f"c{row}{column}" for row, column in above]
    products = [f"({units[row]})*({units[column]})" for row, column in above]
    told = {n: f"{np.cov(noise.T)[at]:.17g}" for n, at in zip(names, above, strict=True)}
    missing = dict.fromkeys(names, "0") | {"c00": "-1"}
    (tmp_path / "gnss.csv").write_text(
        "\n".join(
            [
                ",".join(["time", *labels, *names]),
                *(
                    ",".join([str(at), *map(str, row), *(told if at else missing).values()])
                    for at, row in enumerate(noise)
                ),
            ]
        )
    )
    columns = dict(zip([*labels, *names], [*units, *products], strict=True))
    said = ", ".join(f'{name} = "{unit}"' for name, unit in columns.items())
    (tmp_path / "log.toml").write_text(f'frame = "ned"\nsources.gnss.columns = {{ {said} }}\n')
    table = read_log(str(tmp_path)).tables["gnss"]
    measured = {label: table.columns[label] for label in labels}
    spec = SensorConfig(model=model, covariance=names)
    found = np.asarray(read_covariances(spec, "gnss", table, cls, measured, []))
    oracle = np.cov(np.stack(list(measured.values())))
    np.testing.assert_allclose(found[1], oracle, rtol=1e-12)
    assert found[0, 0, 0] == -1.0  # the reading is not there, in any frame
    assert not np.allclose(oracle, np.cov(noise.T))
    with pytest.raises(DataError, match="found covariances of frame 'ned'"):
        write_log(tmp_path / "again", read_log(str(tmp_path)))
