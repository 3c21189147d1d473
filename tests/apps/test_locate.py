"""``kedge locate``: a fix for each epoch of a log, with all that speaks for and against it."""

import csv
import json

import jsonschema
import numpy as np
import pytest

from kedge.apps.locate import Options, execute
from kedge.apps.summaries import summary_schema
from kedge.core.errors import ConfigError, DataError
from kedge.evaluation.record import record
from kedge.formats.results import plain

ANCHORS = np.array([[0.0, 0.0, 2.0], [10.0, 0.0, 2.0], [10.0, 8.0, 2.5], [0.0, 8.0, 2.0]])
RIG = """
format = "folder"
[vehicle]
model = "still"
[sensors.uwb]
model = "ranges"
map = "anchors"
parameters = { range_std = 0.05, tag_height = 0.5 }
[maps.anchors]
ids = ["A", "B", "C", "D"]
[maps.anchors.columns]
position_x = [0.0, 10.0, 10.0, 0.0]
position_y = [0.0, 0.0, 8.0, 8.0]
position_z = [2.0, 2.0, 2.5, 2.0]
offset = [0.3, 0.0, 0.0, -0.2]
scale = [1.0, 1.0, 1.0, 1.0]
std = [0.0, 0.0, 0.0, 0.0]
[prior]
mean = { position = [5.0, 4.0] }
std = { position = 5.0 }
"""
LOG = """
truth = "truth"
[sources.uwb]
file = "uwb.csv"
target = "target"
columns = { range = "m" }
[sources.truth]
file = "truth.csv"
columns = { position_x = "m", position_y = "m" }
"""


@pytest.fixture
def case(tmp_path):
    rng = np.random.default_rng(15)
    (tmp_path / "rig.toml").write_text(RIG)
    log = tmp_path / "log"
    log.mkdir()
    (log / "log.toml").write_text(LOG)
    rows, path = ["time,target,range"], ["time,position_x,position_y"]
    for epoch in range(60):
        x, y = 2 + 0.1 * epoch, 3.0
        path.append(f"{epoch},{x},{y}")
        for number, anchor in enumerate(ANCHORS):
            if epoch >= 55 and number > 0:
                continue  # only one anchor is heard in the end
            length = np.linalg.norm(anchor - [x, y, 0.5]) + [0.3, 0, 0, -0.2][number]
            length += 0.05 * rng.standard_normal()
            rows.append(f"{epoch + 0.001 * number},{'ABCD'[number]},{length:.6f}")
    rows.append("59.9,X,3.0")  # an anchor that is not on the map
    (log / "uwb.csv").write_text("\n".join(rows) + "\n")
    (log / "truth.csv").write_text("\n".join(path) + "\n")
    return str(tmp_path / "rig.toml"), str(log), tmp_path / "out"


def test_fixes_with_their_accuracy(case):
    rig, log, out = case
    summary = execute(rig, log, out, Options(("gls", "ml"), report=False))
    written = json.loads((out / "summary.json").read_text())
    jsonschema.validate(written, summary_schema())
    found = written["filters"]
    assert found == plain(record(summary.filters))
    assert any("1 ranges of anchors that are not on the map" in n for n in summary.about.notes)
    for name in ("gls", "ml"):
        assert found[name]["epochs"] == 60
        assert found[name]["fixes"] == 55
        assert found[name]["too_few"] == 5
        assert found[name]["rmse"]["position"] < 0.08
        # 55 draws of two squares scatter by a fifth.
        assert found[name]["nees"] == pytest.approx(2, abs=0.9)
    assert found["ml"]["rmse"]["position"] <= 1.1 * found["gls"]["rmse"]["position"]
    rows = list(csv.DictReader((out / "fixes_ml.csv").read_text().splitlines()))
    assert rows[0]["status"] == "FIX"
    assert rows[-1]["status"] == "TOO_FEW"
    assert rows[-1]["position_x"] == ""
    assert float(rows[0]["position_x"]) == pytest.approx(2.0, abs=0.25)
    assert {"residual_A", "crlb", "hdop", "redundancy"} <= rows[0].keys()


def test_a_rig_without_ranges_and_a_solver_that_there_is_not(case, tmp_path):
    rig, log, out = case
    with pytest.raises(ConfigError, match="no solver called 'mll'"):
        execute(rig, log, out, Options(("mll",)))
    with pytest.raises(ConfigError, match="no sensor of ranges called 'lidar'; there are uwb"):
        execute(rig, log, out, Options(("ml",), sensor="lidar"))
    with pytest.raises(DataError, match="window is -1 s"):
        execute(rig, log, out, Options(("ml",), window=-1.0))
    assert not out.exists()
