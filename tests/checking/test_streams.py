"""How readings come, and where a model stops to hold: on numbers made by hand."""

import numpy as np
import pytest

from kedge.checking.streams import Judged, stream, unfit


def test_a_stream_is_told_by_its_usual_step():
    time = np.delete(np.arange(0.0, 10.0, 0.1), np.arange(40, 50))
    seen = stream(time)
    assert seen is not None
    assert seen.rate == pytest.approx(10)
    assert seen.jitter == pytest.approx(0, abs=1e-9)
    assert seen.longest_gap == pytest.approx(1.1)
    assert (seen.readings, seen.gaps) == (90, 1)


def test_jitter_is_a_deviation_in_seconds(key):
    """Stamps of 10 ms jitter: steps scatter by that times the root of two."""
    random = np.random.default_rng(3)
    time = np.sort(np.arange(2000) + 0.01 * random.normal(size=2000))
    seen = stream(time)
    assert seen is not None
    assert seen.jitter == pytest.approx(0.01 * np.sqrt(2), rel=0.1)


def test_two_readings_are_no_stream():
    assert stream(np.array([0.0, 1.0])) is None


def test_a_stretch_of_worse_readings_is_named_and_a_single_outlier_is_not():
    random = np.random.default_rng(5)
    time, nis = np.arange(0.0, 100.0, 0.1), random.chisquare(2, 1000)
    nis[700] = 80.0
    nis[300:400] *= 12
    zeros, twos = np.zeros(1000, int), np.full(1000, 2)
    (span,) = unfit(Judged(time, np.arange(1000), zeros, nis, twos, np.zeros((1000, 2))))
    assert span == pytest.approx((30.0, 40.0), abs=2.1)


def test_a_log_as_foreseen_has_no_such_stretch():
    random = np.random.default_rng(6)
    for rate in (1.0, 200.0):  # windows hold ten readings, and two seconds
        time = np.arange(0.0, 200.0, 1 / rate)
        count = len(time)
        nis, zeros = random.chisquare(3, count), np.zeros(count, int)
        judged = Judged(time, zeros, zeros, nis, np.full(count, 3), np.zeros((count, 3)))
        assert unfit(judged) == []
