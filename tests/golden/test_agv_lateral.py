"""Lane keeping in closed loops: the bands of the specification, at its number of runs."""

import pytest

from kedge.apps.study import Options, execute
from kedge.evaluation.record import record
from kedge.studies.claims import TRUE

pytestmark = pytest.mark.slow


def study(filters, *changes):
    options = Options(filters=filters, changes=changes, chunk=100)
    return record(execute("agv-lateral", options))


@pytest.fixture(scope="module")
def linear_and_not():
    return study("kalman,extended")


def test_expected_figures(linear_and_not):
    judged = {
        band["score"]: band
        for band in linear_and_not["expected"]
        if not band["score"].startswith("ensemble")
    }
    assert len(judged) == 10
    wrong = {score: band for score, band in judged.items() if band["verdict"] != TRUE}
    assert not wrong


def test_the_nonlinear_term_shows_in_the_speed_alone(linear_and_not):
    """0.0244 against 0.0251 m/s; the others are alike to the digits that are printed."""
    ratios = linear_and_not["filters"]["extended"]["all_steps"]["ratios"]
    assert ratios["speed_error"] == pytest.approx(0.0244 / 0.0251, abs=0.01)
    for field in ("offset", "heading_error", "lateral_velocity", "yaw_rate"):
        assert ratios[field] == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize(
    ("feedback", "offset", "heading", "step"),
    [("truth", 0.0159, 0.0093, 0.00079), ("readings", 0.0267, 0.0097, 0.0188)],
)
def test_tracking_by_the_truth_and_by_raw_readings(feedback, offset, heading, step):
    """Raw readings track better than the filter, with 15 times the steering."""
    found = study("extended", f'scenario.feedback="{feedback}"')["filters"]["extended"]
    tracking = found["tracking"]
    assert tracking["offset"] == pytest.approx(offset, rel=0.03)
    assert tracking["heading_error"] == pytest.approx(heading, rel=0.03)
    assert tracking["steering_rate"] * 0.02 == pytest.approx(step, rel=0.02)


def test_a_road_that_nobody_knows():
    found = study("kalman", "world.parameters.curvature_known=false")["filters"]["kalman"]
    assert found["tracking"]["offset"] == pytest.approx(0.450, rel=0.03)
    rmse, consistency = found["all_steps"]["rmse"], found["all_steps"]
    assert rmse["offset"] == pytest.approx(0.0750, rel=0.03)
    assert rmse["heading_error"] == pytest.approx(0.0036, rel=0.03)
    assert rmse["lateral_velocity"] == pytest.approx(0.168, rel=0.03)
    assert consistency["nees"] == pytest.approx(65, rel=0.03)
    assert consistency["nis"]["camera"] == pytest.approx(5.8, rel=0.03)
