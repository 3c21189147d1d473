import gzip
from pathlib import Path

import numpy as np
import pytest

from kedge.core.errors import DataError, UnknownName
from kedge.formats.readers import read_log


@pytest.fixture
def folder(tmp_path) -> Path:
    """A set with robots 1 and 2; the second is packed."""
    folder = tmp_path / "MRCLAM_Dataset0"
    folder.mkdir()
    files = {
        "Barcodes": "# subject barcode\n 1 5\n 2 14\n 6 63\n",
        "Landmark_Groundtruth": "# a map\n 6 1.5 -2.5 0.001 0.002\n",
        "Robot1_Odometry": "# t v w\n10.001 0.1 0.2\n10.003 0.3 0.4\n10.002 0.5 0.6\n",
        "Robot1_Measurement": "10.002 63 2.0 -0.5\n10.002 14 1.0 0.5\n10.004 99 3.0 0.1\n",
        "Robot1_Groundtruth": "10.000 0 0 0\n10.004 1 2 3\n",
    }
    for name, text in files.items():
        (folder / f"{name}.dat").write_text(text)
    files["Robot1_Odometry"] = "1 0.1 0\n1 0.1 0\n2 0.1 0\n2 0.3 0\n3 0.1 0\n"
    for name in ("Odometry", "Measurement", "Groundtruth"):
        data = gzip.compress(files[f"Robot1_{name}"].encode())
        (folder / f"Robot2_{name}.dat.gz").write_bytes(data)
    return folder


def test_a_robot(folder):
    raw = read_log(f"{folder}#1", "mrclam")
    odometry, camera = raw.tables["odometry"], raw.tables["camera"]

    assert odometry.stamps.tolist() == [10_001_000_000, 10_002_000_000, 10_003_000_000]
    np.testing.assert_array_equal(odometry.columns["yaw_rate"], [0.2, 0.6, 0.4])
    assert odometry.lines.tolist() == [2, 4, 3]
    assert camera.texts == {"target": ["6", "2", "barcode:99"]}
    np.testing.assert_array_equal(camera.columns["bearing"], [-0.5, 0.5, 0.1])
    assert raw.truth is not None
    np.testing.assert_array_equal(raw.truth.columns["heading"], [0.0, 3.0])
    assert raw.maps["landmarks"].ids == ("6",)
    np.testing.assert_array_equal(raw.maps["landmarks"].columns["position_y"], [-2.5])
    assert raw.notes == (
        "odometry: time went backwards 1 times; rows were sorted",
        "camera: 1 readings of barcode 99, which no subject wears",
    )
    assert len(raw.files) == 5


def test_stamps_that_come_twice_are_dropped_and_counted(folder):
    raw = read_log(f"{folder.parent}#2", "mrclam")
    assert raw.title == "MRCLAM_Dataset0, robot 2"
    np.testing.assert_array_equal(raw.tables["odometry"].columns["speed"], [0.1, 0.3, 0.1])
    assert raw.notes[:2] == (
        "odometry: dropped 1 identical rows of a stamp used before",
        "odometry: dropped 1 rows of a stamp used before, other values; the last stays",
    )


def test_what_is_wrong_with_a_set(folder):
    with pytest.raises(DataError, match="there are MRCLAM_Dataset0#1, MRCLAM_Dataset0#2"):
        read_log(str(folder), "mrclam")
    with pytest.raises(UnknownName, match=r"no robot called '7'; there are 1, 2"):
        read_log(f"{folder}#7", "mrclam")
    (folder / "Robot1_Odometry.dat").write_text("# nothing\n1 0.1 fast\n")
    with pytest.raises(
        DataError, match=r"Robot1_Odometry.dat:2: column 'yaw_rate': found 'fast'"
    ):
        read_log(f"{folder}#1", "mrclam")
    (folder / "Robot1_Groundtruth.dat").unlink()
    (folder / "Robot1_Odometry.dat").write_text("1 0.1 0\n")
    with pytest.raises(DataError, match=r"Robot1_Groundtruth.dat: no such file"):
        read_log(f"{folder}#1", "mrclam")
    (folder / "Barcodes.dat").unlink()
    with pytest.raises(DataError, match=r"expected Barcodes.dat .* found it in none"):
        read_log(f"{folder}#1", "mrclam")
    with pytest.raises(DataError, match="no such folder"):
        read_log(f"{folder}x#1", "mrclam")


def test_the_recorded_set(data):
    """Counts against the files' own lines, and residuals against Vicon."""
    raw = read_log(f"{data / 'mrclam'}#3", "mrclam")
    assert {name: len(table.stamps) for name, table in raw.tables.items()} == {
        "odometry": 55085 - 4 - 3,
        "camera": 5399,
    }
    assert raw.tables["odometry"].stamps[0] == 1248446190755000000
    unknown = [t for t in raw.tables["camera"].texts["target"] if t.startswith("barcode:")]
    assert len(unknown) == 9

    # The landmarks are where the camera says: median range residual within the camera's noise.
    camera, truth, marks = raw.tables["camera"], raw.truth, raw.maps["landmarks"]
    assert truth is not None
    index = {name: at for at, name in enumerate(marks.ids)}
    rows = [i for i, t in enumerate(camera.texts["target"]) if t in index]
    at = [index[camera.texts["target"][i]] for i in rows]
    gaps = [
        marks.columns[axis][at]
        - np.interp(camera.stamps[rows], truth.stamps, truth.columns[axis])
        for axis in ("position_x", "position_y")
    ]
    residual = camera.columns["range"][rows] - np.hypot(*gaps)
    assert abs(np.median(residual)) < 0.1
    assert np.median(np.abs(residual)) < 0.2


def test_a_code_that_is_no_whole_number_is_refused(folder):
    file = folder / "Barcodes.dat"
    file.write_text(file.read_text().replace("63", "nan"))
    with pytest.raises(DataError, match=r"Barcodes.dat:\d+: .*'nan', expected a whole"):
        read_log(f"{folder}#1", "mrclam")
