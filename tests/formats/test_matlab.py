"""Matrices and structures from MATLAB files, whole and damaged; SciPy is the oracle."""

import random
import tracemalloc

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from kedge.core.errors import DataError
from kedge.formats.matlab import read_matrix, read_structure

ROWS = np.arange(12.0).reshape(4, 3) / 7
CONTENT = {
    "text": "no matrix",
    "rows": ROWS,
    "whole": ROWS.astype(np.int16),
    "imu": {"t": ROWS[:, :1], "rate": ROWS, "name": "an IMU", "few": np.uint8([[3]])},
    "waves": ROWS + 1j,
}


@pytest.fixture(params=[False, True], ids=["plain", "packed"])
def path(request, tmp_path):
    path = tmp_path / "set.mat"
    savemat(path, CONTENT, do_compression=request.param)
    return path


def test_matrices_and_structures_are_those_that_scipy_reads(path):
    known = loadmat(path)
    for name in ("rows", "whole"):
        np.testing.assert_array_equal(read_matrix(path, name), known[name])
    found = read_structure(path, "imu")
    assert list(found) == ["t", "rate", "few"]
    for field, values in found.items():
        np.testing.assert_array_equal(values, known["imu"][field][0, 0])


@pytest.mark.parametrize(
    ("read", "name", "message"),
    [
        (read_matrix, "row", "did you mean 'rows'"),
        (read_matrix, "imu", "found a structure, expected a matrix"),
        (read_structure, "rows", "found a matrix, expected a structure"),
        (read_matrix, "text", "text is no matrix of real numbers"),
        (read_matrix, "waves", "waves is no matrix of real numbers"),
    ],
)
def test_what_is_asked_for_and_is_not_there_is_said(path, read, name, message):
    with pytest.raises(DataError, match=message):
        read(path, name)


def test_a_damaged_file_is_refused_or_read_and_takes_no_more_memory_than_it_can_fill(path):
    good, refused = path.read_bytes(), 0
    tracemalloc.start()
    for seed in range(400):
        draw, data = random.Random(seed), bytearray(good)
        for _ in range(draw.randrange(1, 4)):
            data[draw.randrange(128, len(data))] = draw.choice(
                [0, 0x7F, 0xFF, draw.randrange(256)]
            )
        path.write_bytes(data[: draw.randrange(len(data))] if seed % 4 == 0 else data)
        for read, name in ((read_matrix, "rows"), (read_structure, "imu")):
            try:
                assert read(path, name) is not None
            except DataError:
                refused += 1
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert refused > 200
    assert peak < 2e6


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "begins otherwise"),
        (b"MATLAB 5.0 MAT-file", "cannot be read"),
        (b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM", "-v7"),
    ],
)
def test_other_files_are_named(tmp_path, data, message):
    (tmp_path / "other.mat").write_bytes(data)
    with pytest.raises(DataError, match=message):
        read_matrix(tmp_path / "other.mat", "rows")
