import json

import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import DataError
from kedge.live.describe import describe
from kedge.live.faults import Switched, with_fault
from kedge.live.frame import COLUMNS, encode
from kedge.live.places import place_of
from kedge.live.service import Service
from kedge.live.simulated import FLEET, Fleet, drive
from kedge.vehicles.unicycle import State

pytestmark = pytest.mark.slow  # a drive is simulated first


@pytest.fixture(scope="module")
def carrier():
    plan = FLEET[0]
    return drive(plan._replace(overrides=plan.overrides | {"scenario.duration": "40.0"}))


@pytest.fixture
def fleet(carrier):
    return Fleet([carrier])


def driven(fleet, steps):
    return [fleet.step() for _ in range(steps)]


def test_the_ellipse_of_a_place_is_that_of_its_covariance():
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    cov = np.eye(3)
    cov[:2, :2] = turn @ np.diag([9.0, 4.0]) @ turn.T
    place = place_of(Gaussian(State(np.array([1.0, 2.0]), np.array(0.3)), cov))
    assert (place.x, place.y, place.heading) == (1.0, 2.0, 0.3)
    # The root of the 95 % point of a chi-square of two degrees is 2.4477.
    np.testing.assert_allclose([place.major, place.minor], [3 * 2.4477, 2 * 2.4477], rtol=1e-4)
    assert np.tan(place.angle) == pytest.approx(4 / 3)


def test_a_carrier_is_followed(fleet):
    frames = driven(fleet, 300)
    column = COLUMNS.index
    poses = np.array([frame.poses[0] for frame in frames[50:]])
    x, y, true_x, true_y = (poses[:, column(name)] for name in ("x", "y", "trueX", "trueY"))
    off = np.hypot(x - true_x, y - true_y)
    inside = off < poses[:, column("major")]
    assert np.mean(inside) > 0.9
    assert fleet.engine.vehicles[0].status.value == "OK"


def test_silence_becomes_dead_reckoning_and_ends(fleet):
    driven(fleet, 100)
    fleet.inject(0, "dropout", seconds=5)
    tails = [frame.tail for frame in driven(fleet, 100)]
    statuses = [event["to"] for tail in tails for event in tail["events"]]
    assert statuses[-2:] == ["DEAD_RECKONING", "OK"]
    assert tails[10]["faults"][0]["kind"] == "dropout"
    assert tails[60]["faults"] == []


@pytest.mark.parametrize(
    ("kind", "verdict"), [("nan", "NOT_FINITE"), ("outliers", "GATED"), ("clock", "LATE")]
)
def test_what_a_fault_changes_gets_its_verdict(fleet, kind, verdict):
    driven(fleet, 100)
    fleet.inject(0, kind, seconds=2)
    readings = [one.verdict.name for frame in driven(fleet, 20) for _, one in frame.readings]
    assert set(readings) == {verdict}


def test_the_digest_is_that_of_the_rows_at_any_speed(carrier):
    digests = set()
    for speed in (1.0, 10.0, 100.0):
        service = Service(Fleet([carrier]), speed)
        for _ in range(50):
            service.turn()
        digests.add(service.fleet.engine.digest)
    other = Fleet([carrier])
    other.inject(0, "outliers")
    driven(other, 50)
    assert len(digests) == 1
    assert other.engine.digest not in digests


def test_it_starts_afresh_at_the_end_of_its_drive(fleet):
    driven(fleet, 405)
    assert fleet.engine.vehicles[0].starts == 2
    assert encode(fleet.step(), 0)


def test_what_it_says_is_json_without_nan(fleet):
    about = json.loads(json.dumps(describe(fleet), allow_nan=False))
    frame = driven(fleet, 5)[-1]
    detail = frame.tail["details"][0]
    vehicle = about["vehicles"][0]
    assert len(vehicle["fields"]) == len(detail["state"]) == len(detail["sigma"]) == 3
    assert [s["absolute"] for s in vehicle["sources"]] == [True]
    assert vehicle["sources"][0]["measures"] == [
        {"name": "range", "unit": "m"}, {"name": "bearing", "unit": "rad"},
    ]  # fmt: skip


def test_rows_without_the_sensor_are_not_copied(carrier):
    fault = Switched(0, "nan", 0, 0, 0.0, 1.0)
    assert with_fault(carrier.rows, fault, np.array([5]), carrier.std) is carrier.rows


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (
            {"fault": {"vehicle": 9, "kind": "nan"}},
            "vehicle is 9, expected a number from 0 to 0",
        ),
        ({"fault": {"vehicle": True, "kind": "nan"}}, "vehicle is True"),
        ({"fault": {"vehicle": 0, "kind": "fire"}}, "kind is 'fire', expected one of dropout"),
        ({"fault": {"vehicle": 0, "kind": ["nan"]}}, "kind is"),
        ({"fault": {"vehicle": 0, "kind": "nan", "source": 4}}, "source is 4, expected 0 to 0"),
        ({"fault": {"vehicle": 0, "kind": "nan", "seconds": float("nan")}}, "seconds is nan"),
        ({"fault": 3}, "found 3, expected an object"),
        ({"stop": 0}, "stop is 0, expected the id of a fault"),
    ],
)
def test_what_names_nothing_is_refused(fleet, message, text):
    with pytest.raises(DataError, match=text):
        Service(fleet).obey(message)
