import json
import struct

import numpy as np
import pytest

from kedge.core.verdicts import Verdict
from kedge.live.frame import COLUMNS, Frame, encode
from kedge.live.watch import Judged


def judged(nis=1.5, threshold=9.2):
    number = np.array
    return Judged(
        1, 2, 9.9, 9.5, Verdict.GATED, nis, 2, threshold,
        number([4.0, 5.0]), number([0.5, -1.0]), number([0.1, 0.2]),
    )  # fmt: skip


def test_the_bytes_are_those_that_the_page_reads():
    poses = np.arange(2.0 * len(COLUMNS)).reshape(2, -1)
    tail = {"events": [], "faults": [], "details": None}
    data = encode(Frame(10.0, poses, [(1, judged())], bytes([1, 2, 3]), tail), 7)
    magic, version, header = struct.unpack_from("<IHH", data)
    assert (magic, version, header) == (int.from_bytes(b"KDG1", "little"), 1, 32)
    assert struct.unpack_from("<d", data, 8) == (10.0,)
    assert struct.unpack_from("<4H", data, 16) == (2, 14, 1, 3)
    sequence, length = struct.unpack_from("<2I", data, 24)
    assert sequence == 7
    assert struct.unpack_from("<28f", data, 32) == tuple(range(28))
    at = 32 + 4 * 28
    assert struct.unpack_from("<HBBhH", data, at) == (1, 1, Verdict.GATED, 2, 2)
    numbers = struct.unpack_from("<10f", data, at + 8)
    expected = [0.1, 0.5, 1.5, 9.2, 4.0, 5.0, 3.5, 6.0, 0.1, 0.2]
    np.testing.assert_allclose(numbers, expected, rtol=1e-6)
    at += 48
    assert data[at : at + 4] == bytes([1, 2, 3, 0])
    assert len(data) == at + 4 + length
    assert json.loads(data[at + 4 :]) == tail


def test_what_was_not_judged_is_minus_one():
    poses = np.zeros((1, len(COLUMNS)))
    data = encode(Frame(0.0, poses, [(0, judged(np.nan, np.inf))], b"", {}), 0)
    assert struct.unpack_from("<2f", data, 32 + 4 * 14 + 16) == (-1.0, -1.0)


def test_a_number_that_is_none_is_never_sent_as_json():
    frame = Frame(0.0, np.zeros((1, len(COLUMNS))), [], b"", {"x": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        encode(frame, 0)
