"""What a driver hands over: a mistake raises by name, a fault has a verdict, neither stays."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError, DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.online import Estimator
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.gnss import Measurement
from kedge.sensors.landmarks import Measurement as Sight
from kedge.vehicles.unicycle import Control

EAST = Measurement(np.array([1.0, 0.0]))
ENSEMBLE = EnsembleKalman(count=7)


def words(estimator):
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(estimator.belief)]


@pytest.fixture
def estimator(rig, key):
    made = Estimator(ExtendedKalman(), rig, key, control=Control(1.0, 0.0))
    made.push(0.5, "gnss", EAST)
    return made


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("filter", [ExtendedKalman(), ENSEMBLE], ids=["extended", "ensemble"])
def test_a_control_that_is_not_finite_does_not_hold(rig, key, filter, bad):
    told, untold = (Estimator(filter, rig, key, control=Control(1.0, 0.0)) for _ in range(2))
    answer = told.push(0.5, "gnss", EAST, control=Control(bad, 0.0))
    assert (answer.verdict, answer.control) == (Verdict.FUSED, Verdict.NOT_FINITE)
    untold.push(0.5, "gnss", EAST)
    for one in (told, untold):
        one.push(1.0, "gnss", EAST)
    assert words(told) == words(untold)


def test_a_control_has_a_verdict_too(estimator):
    assert estimator.push(1.0, control=Control(1.0, 0.1)).control == Verdict.FUSED
    assert estimator.push(1.0).control == Verdict.NONE
    late = estimator.push(0.2, control=Control(1.0, 0.1))
    assert (late.verdict, late.control) == (Verdict.LATE, Verdict.LATE)
    assert estimator.push(0.2).verdict == Verdict.LATE


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"measurement": [1.0, 2.0]}, ContractError,
         r"a reading of 'gnss': found list, expected gnss.Measurement\(position\)"),
        ({"measurement": Sight(1.0, 2.0)}, ContractError, "found Measurement, expected gnss"),
        ({"measurement": None}, ContractError, "found NoneType"),
        ({"measurement": Measurement(np.ones(3))}, DataError,
         "a reading of 'gnss': position: found 3 numbers, expected 2 numbers"),
        ({"measurement": Measurement(1.0)}, DataError, "found one number, expected 2 numbers"),
        ({"measurement": Measurement(["1", "2"])}, DataError, "position: found str"),
        ({"measurement": Measurement([[1.0], [1.0, 2.0]])}, DataError, "found list"),
        ({"cov": np.eye(3)}, DataError, "covariance: found 3 x 3 numbers, expected 2 x 2"),
        ({"cov": 0.09}, DataError, "covariance: found one number, expected 2 x 2 numbers"),
        ({"cov": np.ones(2)}, DataError, "covariance: found 2 numbers"),
        ({"target": 1.5}, DataError, "target is 1.5, expected its row in the map"),
        ({"target": "A7"}, DataError, "target is 'A7'"),
        ({"control": (1.0, 2.0, 3.0)}, ContractError,
         r"the control: found tuple, expected unicycle.Control\(speed, yaw_rate\)"),
        ({"control": {"speed": 1.0, "yaw_rate": 0.0}}, ContractError, "found dict"),
        ({"control": Control(np.ones(2), 0.0)}, DataError, "control: speed: found 2 numbers"),
    ],
)  # fmt: skip
def test_the_wrong_form_is_named_and_changes_nothing(estimator, given, error, message):
    before, time = words(estimator), estimator.time
    event = {"time": 1.0, "sensor": "gnss", "measurement": EAST} | given
    with pytest.raises(error, match=message):
        estimator.push(**event)
    assert (words(estimator), estimator.time) == (before, time)
    assert estimator.push(1.0, "gnss", EAST).verdict == Verdict.FUSED


@pytest.mark.parametrize("filter", [ExtendedKalman(), ENSEMBLE], ids=["extended", "ensemble"])
def test_a_reading_beyond_all_numbers_spoils_nothing(rig, key, filter):
    estimator = Estimator(filter, rig, key, control=Control(1.0, 0.0))
    beyond = Measurement([1e300, 0.0])
    assert estimator.push(0.5, "gnss", beyond).verdict == Verdict.NOT_FINITE
    after = estimator.push(1.0, "gnss", EAST)
    assert after.verdict == Verdict.FUSED
    assert np.abs(after.moments.mean.position - EAST.position).max() < 1.0


@pytest.mark.parametrize("target", [99, 2**63, 10**40, -(10**40)])
def test_a_target_beyond_all_maps_is_unknown(estimator, target):
    answer = estimator.push(1.0, "camera", Sight(2.0, 0.1), target=target)
    assert answer.verdict == Verdict.UNKNOWN_TARGET


@pytest.mark.parametrize(
    "control", [Control(np.nan, 0.0), (1.0, 0.0), Control(np.ones(2), 0.0)]
)
def test_a_first_control_of_no_use_is_refused(rig, control):
    with pytest.raises((ContractError, DataError), match="the control: "):
        Estimator(ExtendedKalman(), rig, control=control)


def test_a_first_event_of_another_clock_than_the_start(rig, key):
    unset = Estimator(ExtendedKalman(), rig, key)
    with pytest.raises(DataError, match=r"first event is at 1700000000 s, .* give the time of"):
        unset.push(1.7e9, "gnss", EAST)
    given = Estimator(ExtendedKalman(), rig, key, start=1.7e9)
    assert given.push(1.7e9 + 0.5, "gnss", EAST).verdict == Verdict.FUSED


@pytest.mark.parametrize("filter", [ExtendedKalman(), ENSEMBLE], ids=["extended", "ensemble"])
def test_to_peek_is_to_push_and_changes_nothing(rig, key, filter):
    one, other = (Estimator(filter, rig, key, control=Control(1.0, 0.2)) for _ in range(2))
    one.push(0.5, "gnss", EAST)
    other.push(0.5, "gnss", EAST)
    before, ahead = words(one), one.peek(0.9)
    assert (words(one), one.time) == (before, 0.5)
    pushed = other.push(0.9).moments
    for mine, theirs in zip(jax.tree.leaves(ahead), jax.tree.leaves(pushed), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    with pytest.raises(DataError, match=r"peek at 0.1 s: the newest event is at 0.5 s"):
        one.peek(0.1)


def test_a_second_thread_is_refused(estimator):
    errors = []

    def push():
        try:
            estimator.push(1.0, "gnss", EAST)
        except ContractError as error:
            errors.append(str(error))

    thread = threading.Thread(target=push)
    thread.start()
    thread.join()
    assert len(errors) == 1
    assert errors[0].startswith("an estimator belongs to the thread of its first event")
    assert estimator.push(1.0, "gnss", EAST).verdict == Verdict.FUSED


def test_refusals_use_no_jax(estimator, monkeypatch):
    """Else each costs ten times what a reading costs that is fused."""

    def called(*arguments, **named):
        raise AssertionError("JAX was called")

    estimator.push(1.0, "gnss", EAST)
    for name in ("asarray", "full", "where"):
        monkeypatch.setattr(jnp, name, called)
    assert estimator.push(0.2, "gnss", EAST).verdict == Verdict.LATE
