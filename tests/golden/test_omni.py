"""Paper B's robot: the bands of the specification, at its number of runs."""

import pytest

from kedge.apps.study import Options, execute
from kedge.evaluation.record import record
from kedge.studies.claims import OPEN, TRUE

pytestmark = pytest.mark.slow


def study(name, filters, *changes):
    options = Options(filters=filters, changes=changes, chunk=50)
    return record(execute(f"omni-{name}", options))


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
    ("change", "name", "rmse", "rel"),
    [
        ("world.parameters.slip=0", "circle", 0.0147, 0.06),
        ("world.parameters.slip=0", "square", 0.0150, 0.07),
        ("world.parameters.slip=3.0", "circle", 0.0237, 0.06),
        ("world.parameters.slip=3.0", "square", 0.0274, 0.07),
        # Each of these is a program of its own: on the route where it says most.
        ("world.parameters.delay=0.3", "square", 0.0290, 0.07),
        ("sensors.camera.rate=2.0", "circle", 0.0280, 0.06),
    ],
)
def test_ablations(change, name, rmse, rel):
    """Each within what 200 runs scatter in two independent programs, as the base figures."""
    assert error(name, change) == pytest.approx(rmse, rel=rel)


@pytest.mark.parametrize(
    ("feedback", "name", "expected"),
    [
        ("truth", "circle", 0.0075),
        ("readings", "square", 0.0201),
        ("filter", "circle", 0.0183),
        ("filter", "square", 0.0212),
    ],
)
def test_tracking_in_closed_loops(feedback, name, expected):
    found = study(name, "extended", f'scenario.feedback="{feedback}"')
    tracking = found["filters"]["extended"]["tracking"]["position"]
    assert tracking == pytest.approx(expected, rel=0.07)
