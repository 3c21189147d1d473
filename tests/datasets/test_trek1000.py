"""The reader of the TREK1000 room, on files written here."""

import numpy as np
import pytest
from scipy.io import savemat

from kedge.core.errors import DataError, UnknownName
from kedge.datasets.trek1000 import EVERY, ORIGIN, read_trek1000

ROWS = "120115201\t0\t5134\t3770\t3967\t5363\n120115307\t0\t5129\t-1\t3986\t5373\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "output_range_uwb_4vnm.txt").write_text(ROWS)
    (tmp_path / "output_range_uwb_4vba0.txt").write_text(ROWS)
    count = 4 * EVERY
    poses = np.zeros((count, 10))
    # 11:01:15 UTC is 12:01:15 in the room; 2018-11-29.
    poses[:, 1], poses[:, 2] = 1543489275, np.arange(count) * 1e6
    poses[:, 3], poses[:, 4] = ORIGIN[0] - 3.9, ORIGIN[1] - 2.6
    savemat(tmp_path / "4vNM.mat", {"posedata_uwb": poses})
    return tmp_path


def test_ranges_and_truth_at_local_time(folder):
    log = read_trek1000(folder, "4vnm")
    table = log.tables["ranges"]
    start = (12 * 3600 + 60 + 15) * 1_000_000_000
    assert sorted(set(table.stamps.tolist())) == [start + 201_000_000, start + 307_000_000]
    np.testing.assert_allclose(table.columns["range"][:4], [5.134, 3.77, 3.967, 5.363])
    assert table.texts["target"] == ["0", "1", "2", "3", "0", "2", "3"]
    assert table.lines.tolist() == [1] * 4 + [2] * 3
    assert log.notes == ("ranges: 1 ranges that are not above 0 were dropped",)
    assert log.truth.stamps[0] == start
    assert len(log.truth.stamps) == 4
    np.testing.assert_allclose(log.truth.columns["position_x"], 3.9)
    np.testing.assert_allclose(log.truth.columns["position_y"], 2.6)


def test_a_case_has_to_be_named_and_truth_may_be_missing(folder):
    with pytest.raises(DataError, match=r"expected a case after the path; there are .*#4vba0"):
        read_trek1000(folder)
    with pytest.raises(UnknownName, match=r"no case called '4vbaO'.*did you mean '4vba0'"):
        read_trek1000(folder, "4vbaO")
    assert read_trek1000(folder / "output_range_uwb_4vba0.txt").truth is None
    with pytest.raises(DataError, match="expected files output_range_uwb_CASE"):
        read_trek1000(folder / "nowhere")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("129915201\t0\t1\t2\t3\t4\n", ":1: column 'time': found '129915201', expected a time"),
        (ROWS + ROWS, ":3: column 'time': found '120115201' after '120115307'"),
        ("120115201\t0\t1\tx\t3\t4\n", "column '1': found 'x', expected a number"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path, rows, message):
    file = tmp_path / "output_range_uwb_4vnm.txt"
    file.write_text(rows)
    with pytest.raises(DataError, match=message):
        read_trek1000(file)
