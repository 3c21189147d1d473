"""Readers of recorded sets of ranges, on small sets made here, whole and broken."""

import gzip

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from kedge.config.problem import load_problem
from kedge.core.errors import DataError, UnknownName
from kedge.core.verdicts import Verdict
from kedge.datasets.starloc import RIG_FROM_IMU
from kedge.estimation.batch import estimate
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.formats.readers import read_log


def plaza(heading):
    """A mower that goes 1 m east in each of three steps of 0.5 s."""
    time = 100 + 0.5 * np.arange(4)
    return {
        "GT": np.stack([time, np.arange(4.0), np.zeros(4), np.full(4, heading)], axis=1),
        "DR": np.stack([time[1:], np.ones(3), np.full(3, 0.1)], axis=1),
        "TD": np.array([[101, 2, 5, 7.5], [100.2, 2, 6, 8.5]]),
        "TL": np.array([[5, 1, 2], [6, 3, 4]]),
    }


def test_plaza(tmp_path):
    path = tmp_path / "Plaza9_.mat"
    savemat(path, plaza(0.0))
    raw = read_log(str(path), "plaza")
    odometry, radio = raw.tables["odometry"], raw.tables["radio"]
    # An increment is what happened since the row before, so its rate holds from there on.
    assert odometry.stamps.tolist() == [100_000_000_000, 100_500_000_000, 101_000_000_000]
    np.testing.assert_allclose(odometry.columns["speed"], 2.0)
    np.testing.assert_allclose(odometry.columns["yaw_rate"], 0.2)
    assert radio.texts["target"] == ["6", "5"]
    np.testing.assert_array_equal(radio.columns["range"], [8.5, 7.5])
    assert raw.maps["beacons"].ids == ("5", "6")
    assert raw.title == "Plaza9"

    savemat(path, plaza(np.pi))
    raw = read_log(str(path), "plaza")
    assert raw.truth is not None
    np.testing.assert_allclose(raw.truth.columns["heading"], 2 * np.pi)
    assert "turned by half a turn" in " ".join(raw.notes)


def test_what_is_wrong_with_a_plaza_file(tmp_path):
    path = tmp_path / "Plaza9_.mat"
    with pytest.raises(DataError, match="no such file"):
        read_log(str(path), "plaza")
    path.write_text("nonsense")
    with pytest.raises(DataError, match="cannot be read as a MATLAB file"):
        read_log(str(path), "plaza")
    good = plaza(0.0)
    for change, pattern in (
        ({"TL": np.zeros((2, 2))}, r"TL: found shape \(2, 2\), expected rows of 3"),
        ({"TD": np.array([[1, 2, 3, np.nan]] * 2)}, "TD: row 1: expected finite"),
        ({"DR": good["DR"][[0, 2, 1]]}, "DR: row 3: found time that does not go forwards"),
    ):
        savemat(path, good | change)
        with pytest.raises(DataError, match=pattern):
            read_log(str(path), "plaza")
    savemat(path, {k: v for k, v in good.items() if k != "TD"})
    with pytest.raises(DataError, match="no matrix called 'TD'; there are GT, DR, TL"):
        read_log(str(path), "plaza")


INPUT = """\
range2 1.0 2.5 0.04 0.0 1.0 105 0
odom2diff 1.0 0.1 0.2 0 0.0785 1e-4 1e-4 1e-4
pseudorange3 1.0 7
range2 2.0 3.5 0.01 4.0 5.0 106 0
"""


def test_labyrinth(tmp_path):
    (tmp_path / "A_Input.txt").write_text(INPUT)
    (tmp_path / "A_GT.txt").write_text("point2 1.0 3 4 0 0 0 0\n")
    raw = read_log(str(tmp_path), "labyrinth")
    np.testing.assert_allclose(raw.tables["radio"].columns["std"], [0.2, 0.1])
    assert raw.tables["radio"].lines.tolist() == [1, 4]
    np.testing.assert_array_equal(raw.tables["odometry"].columns["left"], [0.1])
    np.testing.assert_array_equal(raw.maps["modules"].columns["position_y"], [1.0, 5.0])
    assert raw.truth is not None
    assert raw.notes == ("A_Input.txt: lines of kind pseudorange3 were left out",)


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (("2.5 0.04", "2.5 0"), r"A_Input\.txt:1: column 'variance': found 0, expected"),
        (("range2 2.0 3.5 0.01", "range2 2.0 3.5"), r":4: found 6 cells after 'range2'"),
        (("4.0 5.0 106", "4.0 5.0 105"), r":4: module '105' stands elsewhere"),
        (("range2 1.0 2.5", "range2 1.0 far"), r":1: column 'range': found 'far'"),
        (("odom2diff", "odom"), r"no line of kind 'odom2diff'"),
    ],
)
def test_what_is_wrong_with_a_labyrinth_file(tmp_path, change, pattern):
    (tmp_path / "A_Input.txt").write_text(INPUT.replace(*change))
    with pytest.raises(DataError, match=pattern):
        read_log(str(tmp_path), "labyrinth")


def lias(folder, drive):
    times = [f"2022-08-15 9:00:0{k}.500" for k in range(4)]
    rows = [
        ",".join([at, *(f"{a + t / 10}" for a in range(8) for t in range(3))]) for at in times
    ]
    with gzip.open(folder / f"UWB_{drive}.csv.gz", "wt") as file:
        file.write("\n".join(rows))
    poses = [f"{at},{k},2,1,0,0,1,0" for k, at in enumerate(times)]
    text = "\n".join(["time,x,y,z,rotation,,,", *poses])
    (folder / f"motion_capture_{drive}.csv.gz").write_bytes(gzip.compress(text.encode()))


def test_lias_trolley(tmp_path):
    lias(tmp_path, "exp_fast")
    raw = read_log(str(tmp_path), "lias_trolley")
    first = raw.tables["tag_1"]
    np.testing.assert_allclose(first.columns["range"][:3], [0.1, 1.1, 2.1])
    assert first.texts["target"][:9] == [*(f"a{k}" for k in range(8)), "a0"]
    # 3 s in all: the first second is surveyed, and what comes after is the truth.
    np.testing.assert_array_equal(raw.tables["survey"].columns["position_x"], [0.0, 1.0])
    assert raw.truth is not None
    np.testing.assert_array_equal(raw.truth.columns["position_x"], [2.0, 3.0])
    np.testing.assert_allclose(raw.truth.columns["heading"], np.pi)

    lias(tmp_path, "exp_mid")
    with pytest.raises(DataError, match=r"#exp_fast, .*#exp_mid"):
        read_log(str(tmp_path), "lias_trolley")
    assert read_log(f"{tmp_path}#exp_mid", "lias_trolley").title == "exp_mid"
    with pytest.raises(UnknownName, match="no drive called 'slow'"):
        read_log(f"{tmp_path}#slow", "lias_trolley")
    bad = tmp_path / "UWB_bad.csv"
    bad.write_text("2022-08-15 9:00:00.1,1\n")
    with pytest.raises(DataError, match=r"UWB_bad\.csv:1: found 2 cells, expected 25"):
        read_log(str(bad), "lias_trolley")
    bad.write_text(",".join(["yesterday", *["1"] * 24]))
    with pytest.raises(DataError, match=r":1: found 'yesterday', expected a time such as"):
        read_log(str(bad), "lias_trolley")


HANYANG = "%time,field.stamp,field.x,field.y,field.z,field.distanceFromTag\n"


def test_hanyang(tmp_path):
    for case in ("Case_1", "Case_2"):
        folder = tmp_path / "LOS" / case
        folder.mkdir(parents=True)
        (folder / "A12.csv").write_text(HANYANG + "9,2000,1,2,3,5.5\n")
        (folder / "A3.csv").write_text(HANYANG + "9,1000,4,5,6,7.5\n9,3000,4,5,6,8.5\n")
    (folder / "trajectory.csv").write_text("timestamp,x,y,z\n1.0e3,1,2,3\n2.0e3,1,2,3\n")
    raw = read_log(f"{tmp_path}#LOS/Case_2", "hanyang_uwb")
    assert raw.tables["radio"].texts["target"] == ["3", "12", "3"]
    assert raw.tables["radio"].lines.tolist() == [2, 2, 3]
    assert raw.maps["anchors"].ids == ("3", "12")
    np.testing.assert_array_equal(raw.maps["anchors"].columns["position_z"], [6, 3])
    assert raw.truth is not None
    with pytest.raises(DataError, match=r"#LOS/Case_1, .*#LOS/Case_2"):
        read_log(str(tmp_path), "hanyang_uwb")
    with pytest.raises(UnknownName, match="no run called 'LOS/Case_3'"):
        read_log(f"{tmp_path}#LOS/Case_3", "hanyang_uwb")
    (folder / "A3.csv").write_text(HANYANG + "9,1000,4,5,6,7.5\n9,3000,4,9,6,8.5\n")
    with pytest.raises(DataError, match=r"A3\.csv:3: column 'field\.y': found 9 after 5"):
        read_log(str(folder), "hanyang_uwb")


def test_starloc(tmp_path):
    """A rig that climbs in a spiral; the clock of its inertial unit is 0.75 s ahead."""
    folder = tmp_path / "spiral_s5"
    folder.mkdir()
    anchor, time = np.array([3.0, -1.0, 2.0]), np.arange(0, 20, 0.05)

    def place(at):
        return np.stack([np.cos(at), 2 * np.sin(0.7 * at), 0.05 * at], axis=-1)

    head = "time_s range from_id to_id x y z w rot_x rot_y rot_z tag_pos_x tag_pos_y tag_pos_z"
    rows = [",".join([*head.split(), "gt_range"])]
    for at, where in zip(time, place(time), strict=True):
        true = np.linalg.norm(where - anchor)
        cells = [at, true + 0.2, 1, 9, *where, 1, 0, 0, 0, *where, true]
        rows.append(",".join(map(repr, map(float, cells))))
    (folder / "uwb.csv").write_text("\n".join(rows))
    names = [
        f"{what}_{a}" for what in ("linear_acceleration", "angular_velocity") for a in "xyz"
    ]
    rows = [",".join(["time_s", *names, "x", "y", "z"])]
    for at, where in zip(time + 0.75, place(time), strict=True):
        rows.append(",".join(map(repr, map(float, [at, 1, 2, 3, 4, 5, 6, *where]))))
    (folder / "imu.csv").write_text("\n".join(rows))

    raw = read_log(str(folder), "starloc")
    found = [raw.maps["anchors"].columns[f"position_{a}"][0] for a in "xyz"]
    np.testing.assert_allclose(found, anchor, atol=1e-6)
    assert raw.tables["tag_1"].texts["target"][0] == "9"
    imu = raw.tables["imu"]
    assert abs(imu.stamps[0] / 1e9) < 0.001
    turn = Rotation.from_rotvec(RIG_FROM_IMU["s5"], degrees=True)
    force = [imu.columns[f"specific_force_{a}"][0] for a in "xyz"]
    np.testing.assert_allclose(force, turn.apply([1.0, 2.0, 3.0]), rtol=1e-12)

    other = tmp_path / "spiral_s9"
    folder.rename(other)
    assert "imu" not in read_log(str(other), "starloc").tables
    (other / "uwb.csv").unlink()
    with pytest.raises(DataError, match=r"uwb\.csv: no such file"):
        read_log(str(other), "starloc")


RIG = """
[vehicle]
model = "wandering"
[sensors.radio]
model = "ranges"
map = "anchors"
target = "anchor"
[prior]
std = { position = 1, velocity = 1 }
"""
LOG = """
[sources.radio]
target = "anchor"
columns = { range = "m" }
[maps.anchors]
ids = ["a", "b"]
values = { position_x = [1, 9], position_y = [2, 9] }
columns = { position_x = "m", position_y = "m" }
"""


def test_a_range_of_nothing_and_an_anchor_off_the_map_get_verdicts(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "log.toml").write_text(LOG)
    rows = ["time,anchor,range", "1,a,2.5", "2,b,0", "3,b,-1", "4,c,3", "5,a,", "6,b,12"]
    (tmp_path / "radio.csv").write_text("\n".join(rows))
    problem = load_problem(str(tmp_path / "rig.toml"), str(tmp_path))
    assert problem.notes == [
        "radio: 2 readings of range are not above 0, the first in line 3; they are refused",
        "radio: 1 readings name targets that are not on the map: c; they are refused",
    ]
    found = estimate(ExtendedKalman(), problem.rig, problem.recording.log)
    verdicts = np.asarray(found.outcome.verdict)
    names = [Verdict(int(v)).name for v in verdicts if v != Verdict.NONE]
    refused = ["NOT_FINITE", "NOT_FINITE", "UNKNOWN_TARGET", "NOT_FINITE"]
    assert names == ["FUSED", *refused, "FUSED"]
    assert np.isfinite(found.moments.cov).all()
