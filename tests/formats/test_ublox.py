"""u-blox files, written by the library that reads them."""

import numpy as np
import pytest
from pyubx2 import GET, UBXMessage

from kedge.core.errors import DataError
from kedge.formats.readers import read_log

NOON = {
    "year": 2024,
    "month": 1,
    "day": 1,
    "hour": 12,
    "min": 0,
    "validDate": 1,
    "validTime": 1,
}
STAMP = 1_704_110_400 * 10**9  # date -ud 2024-01-01T12:00 +%s


def solution(second, lat, **changes):
    fields = NOON | {"second": second, "lat": lat, "lon": 9.0, "height": 500_000, "hAcc": 900}
    fields |= {"velN": 1500, "velE": -500, "velD": 20, "fixType": 3, "gnssFixOk": 1}
    return UBXMessage("NAV", "NAV-PVT", GET, **(fields | changes)).serialize()


def test_places_velocities_and_their_accuracies(tmp_path):
    damaged = bytearray(solution(2, 48.002))
    damaged[40] ^= 1
    parts = [
        b"$GNGGA,not for us*00\r\n",
        solution(0, 47.0, validTime=0),
        solution(0, 48.0, nano=250_000_000),
        solution(1, 48.001, nano=-250_000),
        bytes(damaged),
        solution(3, 0.0, fixType=0, gnssFixOk=0),
    ]
    (tmp_path / "drive.ubx").write_bytes(b"".join(parts))
    raw = read_log(str(tmp_path / "drive.ubx"), "ublox")
    gnss, velocity = raw.tables["gnss"], raw.tables["velocity"]
    np.testing.assert_array_equal(gnss.stamps - STAMP, [250_000_000, 999_750_000])
    np.testing.assert_allclose(gnss.columns["position_y"], [0, 111.2], atol=0.1)
    np.testing.assert_allclose(gnss.columns["horizontal_std"], 0.9)
    np.testing.assert_allclose(velocity.columns["velocity_x"], -0.5)
    np.testing.assert_allclose(velocity.columns["velocity_z"], -0.02)
    assert len(velocity.stamps) == 2
    said = " ".join(raw.notes)
    for what in (
        "1 damaged",
        "1 messages before the receiver knew",
        "1 readings without a fix",
    ):
        assert what in said


def test_a_file_without_solutions_is_refused(tmp_path):
    (tmp_path / "a.ubx").write_bytes(b"\xb5\x62 nothing of the kind")
    with pytest.raises(DataError, match=r"a\.ubx: found no NAV-PVT message .* among 0"):
        read_log(str(tmp_path / "a.ubx"), "ublox")
