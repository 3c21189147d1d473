"""Paper D's dynamic experiment: the bands of the specification; squared and plain ranges."""

import numpy as np
import pytest

from kedge.apps.study import Options, execute
from kedge.evaluation.consistency import chi_square_interval
from kedge.evaluation.record import record
from kedge.studies.claims import FALSE, OPEN, TRUE

pytestmark = pytest.mark.slow
STEPS = "step_20", "step_100", "step_150", "step_200"


def position(study, filter="extended"):
    windows = study["filters"][filter]["windows"]
    return np.array([windows[step]["rmse"]["position"] for step in STEPS])


@pytest.fixture(scope="module")
def squared():
    return record(execute("uwb-imu", Options(filters="extended,dead-reckoning", chunk=220)))


def test_expected_figures(squared):
    assert [band["verdict"] for band in squared["expected"]] == [TRUE] * 8
    assert [claim["verdict"] for claim in squared["claims"]] == [TRUE, FALSE, FALSE]


def test_the_covariance_is_that_of_the_errors(squared):
    """The normalised error squared is its dimension, so sigma is within 5 % of the RMSE."""
    windows = squared["filters"]["extended"]["windows"]
    assert np.sqrt([windows[step]["nees"] / 4 for step in STEPS]) == pytest.approx(1, abs=0.05)


def test_weights_like_the_papers_give_its_column():
    mistuned = record(execute("uwb-imu-mistuned", Options(chunk=220)))
    assert [band["verdict"] for band in mistuned["expected"]] == [TRUE] * 8
    # Row 200 lies within a sixth of the paper's, and its interval reaches beyond.
    assert [claim["verdict"] for claim in mistuned["claims"]] == [OPEN]


def test_plain_ranges_are_as_good_as_squared_ones(squared):
    changes = ['sensors.uwb.model="ranges"']
    plain = record(execute("uwb-imu", Options(filters="extended", chunk=220, changes=changes)))
    assert position(plain) == pytest.approx(position(squared), rel=0.05)


def test_an_imu_as_it_is_sold():
    """One drive: UWB alone, with wheels, two of four anchors blocked, a minute without any."""
    found = record(execute("uwb-imu-agv", Options(filters="extended", runs=16, chunk=16)))
    assert [band["verdict"] for band in found["expected"]] == [TRUE] * 4
    scores = found["filters"]["extended"]
    lower, upper = chi_square_interval(scores["nees_dof"], scores["runs"])
    outside = {
        n: w["nees"] for n, w in scores["windows"].items() if not lower < w["nees"] < upper
    }
    assert not outside
    assert scores["coverage_95"] == pytest.approx(0.95, abs=0.05)
