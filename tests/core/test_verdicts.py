"""Verdicts are written into files: their numbers are for ever."""

from kedge.core.verdicts import Verdict


def test_numbers_never_change():
    assert {verdict.name: int(verdict) for verdict in Verdict} == {
        "FUSED": 0,
        "GATED": 1,
        "LATE": 2,
        "DUPLICATE": 3,
        "FUTURE": 4,
        "NOT_FINITE": 5,
        "BAD_COVARIANCE": 6,
        "UNKNOWN_TARGET": 7,
        "DROPPED": 8,
        "UNPREDICTED": 9,
        "NONE": -1,
    }
