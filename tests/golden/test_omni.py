"""Paper B's robot: the bands of the specification, at its number of runs."""

import pytest

from kedge.apps.study import Options, execute
from kedge.evaluation.study_claims import OPEN, TRUE

pytestmark = pytest.mark.slow


def study(name, filters, *changes):
    options = Options(filters=filters, changes=changes, chunk=50)
    return execute(f"omni-{name}", options)


def error(name, *changes):
    """Root mean squared error of the extended filter's position in m."""
    return study(name, "extended", *changes)["filters"]["extended"]["rmse"]["position"]


@pytest.mark.parametrize("name", ["circle", "square"])
def test_expected_figures_and_claims(name):
    found = study(name, "extended,unscented,dead-reckoning")
    assert len(found["expected"]) == 4
    assert [band for band in found["expected"] if band["verdict"] != TRUE] == []
    verdicts = [claim["verdict"] for claim in found["claims"]]
    assert verdicts == [TRUE, TRUE, OPEN, OPEN, OPEN]


@pytest.mark.parametrize(
    ("name", "rmse", "analytic"), [("circle", 0.0770, 0.0768), ("square", 0.0790, 0.0787)]
)
def test_a_filter_that_trusts_no_motion_gives_the_raw_fixes(name, rmse, analytic):
    """With noise of the motion beyond all measure each fix replaces what was believed."""
    found = error(
        name, "vehicle.parameters.slip_noise=10.0", "vehicle.parameters.turn_noise=10.0"
    )
    assert found == pytest.approx(rmse, rel=0.02)
    assert found == pytest.approx(analytic, rel=0.02)


@pytest.mark.parametrize("name", ["circle", "square"])
def test_the_papers_mistakes_are_told_from_the_robot(name):
    assert error(name, 'vehicle.parameters.kinematics="mirrored"') > 0.3
    assert error(name, 'sensors.camera.model="landmark-pose-unwrapped"') > 0.1


@pytest.mark.parametrize(
    ("change", "circle", "square"),
    [
        ("world.parameters.slip=0", 0.0147, 0.0150),
        ("world.parameters.slip=3.0", 0.0237, 0.0274),
        ("world.parameters.delay=0.3", 0.0174, 0.0290),
        ("sensors.camera.rate=2.0", 0.0280, 0.0309),
    ],
)
def test_ablations(change, circle, square):
    """Each within what 200 runs scatter in two independent programs, as the base figures."""
    assert error("circle", change) == pytest.approx(circle, rel=0.06)
    assert error("square", change) == pytest.approx(square, rel=0.07)


@pytest.mark.parametrize(
    ("feedback", "circle", "square"),
    [("truth", 0.0075, 0.0092), ("readings", 0.0190, 0.0201), ("filter", 0.0183, 0.0212)],
)
def test_tracking_in_closed_loops(feedback, circle, square):
    for name, expected in (("circle", circle), ("square", square)):
        found = study(name, "extended", f'scenario.feedback="{feedback}"')
        tracking = found["filters"]["extended"]["tracking"]["position"]
        assert tracking == pytest.approx(expected, rel=0.07)
