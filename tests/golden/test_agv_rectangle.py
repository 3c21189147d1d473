"""Paper A's rectangle: the bands of the specification, at its number of runs."""

import pytest

from kedge.apps.study import Options, execute
from kedge.evaluation.record import record
from kedge.studies.claims import FALSE, TRUE

pytestmark = pytest.mark.slow
COUNTS = 20, 100, 500


@pytest.fixture(scope="module")
def rectangle():
    ensembles = [f"ensemble:count={count}" for count in COUNTS]
    names = ["kalman", "extended", "unscented", *ensembles, "etkf:count=100"]
    return record(execute("agv-rectangle", Options(filters=",".join(names), chunk=50)))


def ratio(study, name):
    return study["filters"][name]["all_steps"]["ratios"]["position"]


def test_expected_figures(rectangle):
    assert len(rectangle["expected"]) == 7
    assert not [band for band in rectangle["expected"] if band["verdict"] != TRUE]


def test_on_a_linear_model_there_is_one_gaussian_filter(rectangle):
    kalman = rectangle["filters"]["kalman"]
    for name in ("extended", "unscented"):
        other = rectangle["filters"][name]
        for field, rmse in kalman["rmse"].items():
            assert other["rmse"][field] == pytest.approx(rmse, rel=1e-9)
        assert other["nees"] == pytest.approx(kalman["nees"], rel=1e-9)


def test_more_members_are_better_and_square_roots_better_still(rectangle):
    ratios = [ratio(rectangle, f"ensemble:count={count}") for count in COUNTS]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[-1] > 1
    assert ratio(rectangle, "etkf:count=100") < ratio(rectangle, "ensemble:count=100")


def test_matched_filters_are_consistent():
    matched = record(execute("agv-matched", Options(filters="kalman", chunk=200)))
    assert len(matched["expected"]) == 3
    assert not [band for band in matched["expected"] if band["verdict"] != TRUE]


def test_corners():
    corners = record(
        execute("agv-corners", Options(filters="kalman,ensemble:count=500", chunk=50))
    )
    assert [band["verdict"] for band in corners["expected"]] == [TRUE] * 4
    assert [claim["verdict"] for claim in corners["claims"]] == [TRUE, FALSE]
