"""Oracles: the letters of the format, round trips, exact integers."""

import os
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kedge.core.errors import DataError
from kedge.formats.tum import read_tum, write_tum

GOOD = "1.5 1 2 3 0 0 0 1\n"
nanoseconds = st.integers(-(2**63) + 1, 2**63 - 1)
finite = st.floats(-1e9, 1e9)


def test_the_file_reads_as_the_format_says(tmp_path):
    path = tmp_path / "track.tum"
    time = np.array([1_700_000_000_123_456_789, 1_700_000_001_000_000_001])
    turns = np.array([[0.5, 0.1, -0.7, 0.5], [1.0, 0.0, 0.0, 0.0]])
    write_tum(path, time, np.array([[1.25, -2.0, 1e-12], [0.1, 3.0, 0.0]]), turns)
    assert path.read_text() == (
        "# timestamp tx ty tz qx qy qz qw\n"
        "1700000000.123456789 1.25 -2.0 1e-12 0.1 -0.7 0.5 0.5\n"
        "1700000001.000000001 0.1 3.0 0.0 0.0 0.0 0.0 1.0\n"
    )


@given(stamps=st.lists(nanoseconds, min_size=1, max_size=5), data=st.data())
def test_what_is_written_reads_back(tmp_path, stamps, data):
    path, count = tmp_path / "track.tum", len(stamps)
    time = np.array(sorted(stamps))
    rows = data.draw(
        st.lists(st.tuples(finite, finite, finite), min_size=count, max_size=count)
    )
    seed = data.draw(st.integers(0, 2**32 - 1))
    turns = Rotation.random(count, rng=np.random.default_rng(seed)).as_quat()
    write_tum(path, time, np.array(rows), turns[:, [3, 0, 1, 2]])

    found = read_tum(path)
    assert found.time.dtype == np.int64
    np.testing.assert_array_equal(found.time, time)
    np.testing.assert_array_equal(found.position, rows)
    np.testing.assert_allclose(found.orientation, turns[:, [3, 0, 1, 2]], atol=1e-15)
    # Decimal arithmetic is exact, so this is the definition of the stamp.
    texts = [line.split()[0] for line in path.read_text().splitlines()[1:]]
    assert [int(Decimal(text) * 10**9) for text in texts] == time.tolist()


def test_a_heading_turns_about_the_vertical(tmp_path):
    heading = np.array([0.0, 0.3, np.pi / 2, -3.0, 7.0])
    write_tum(tmp_path / "a", np.arange(5), np.ones((5, 2)), heading)
    found = read_tum(tmp_path / "a")
    np.testing.assert_array_equal(found.position, [[1, 1, 0]] * 5)
    ahead = Rotation.from_quat(found.orientation[:, [1, 2, 3, 0]]).apply([1, 0, 0])
    expected = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
    np.testing.assert_allclose(ahead, expected, atol=1e-15)


def test_without_orientation_it_is_the_identity(tmp_path):
    write_tum(tmp_path / "a", np.arange(2), np.ones((2, 3)))
    np.testing.assert_array_equal(read_tum(tmp_path / "a").orientation, [[1, 0, 0, 0]] * 2)


def test_files_of_other_tools_are_read(tmp_path):
    path = tmp_path / "other.txt"
    path.write_text(
        "# ground truth trajectory\n\n"
        "1305031098.6659 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\r\n"
        "  1.3050310995e9\t1 2 3 0 0 0 1.0001\n"
        "1305031100 1 2 3 0 0 0 1"
    )
    found = read_tum(path)
    seconds = [1305031098_665900000, 1305031099_500000000, 1305031100_000000000]
    np.testing.assert_array_equal(found.time, seconds)
    np.testing.assert_allclose(np.linalg.norm(found.orientation, axis=1), 1, rtol=1e-15)
    np.testing.assert_allclose(found.orientation[0], [-0.3986, 0.6132, 0.5962, -0.3311], 1e-3)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2 3", "found 3 fields, expected 8"),
        ("2,1,2,3,0,0,0,1", "found 1 fields"),
        ("2 1 2 x 0 0 0 1", "expected eight numbers"),
        ("x 1 2 3 0 0 0 1", "expected eight numbers"),
        ("nan 1 2 3 0 0 0 1", "expected eight numbers"),
        ("inf 1 2 3 0 0 0 1", "expected eight numbers"),
        ("2 1 nan 3 0 0 0 1", "finite"),
        ("2 1 2 3 0 0 0 0", "length 0, expected 1"),
        ("2 1 2 3 1 0 0 1", "length 1.41421, expected 1"),
        ("1 1 2 3 0 0 0 1", "found stamp 1, expected none before"),
        ("1700000000123456789 1 2 3 0 0 0 1", "expected seconds"),
    ],
)
def test_a_bad_line_is_named(tmp_path, line, message):
    path = tmp_path / "bad.tum"
    path.write_text("# header\n" + GOOD + line + "\n")
    with pytest.raises(DataError, match=message) as caught:
        read_tum(path)
    assert str(caught.value).startswith(f"{path}:3: ")


def test_a_file_without_poses_is_refused(tmp_path):
    (tmp_path / "empty").write_text("# nothing\n")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00\x81")
    for name, message in (("empty", "no pose"), ("binary", "TUM"), ("absent", "TUM")):
        with pytest.raises(DataError, match=message) as caught:
            read_tum(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)


def test_nothing_half_written_is_left_behind(tmp_path, monkeypatch):
    path = tmp_path / "track.tum"
    path.write_text(GOOD)
    position = np.ones((2, 3))
    broken = position * [[1.0], [np.nan]]
    with pytest.raises(DataError, match=r"pose 1, 0\.000000005 s"):
        write_tum(path, np.array([4, 5]), broken)
    with pytest.raises(DataError, match="position"):
        write_tum(path, np.arange(2), np.ones((2, 4)))

    def no_space(*_):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", no_space)
    with pytest.raises(DataError, match="no space left"):
        write_tum(path, np.arange(2), position)
    assert path.read_text() == GOOD
    assert os.listdir(tmp_path) == ["track.tum"]


def test_an_unwritable_place_is_named(tmp_path):
    with pytest.raises(DataError, match="nowhere"):
        write_tum(tmp_path / "nowhere" / "track.tum", np.arange(2), np.ones((2, 3)))
