"""Beliefs given in mid-drive: resets and other filters."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError, DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.online import Estimator
from kedge.estimation.restart import restarted
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.unscented import UnscentedKalman
from kedge.sensors.gnss import Gnss, Measurement
from kedge.vehicles.unicycle import Control, State, Unicycle


def rig(prior=None, std=0.1):
    vehicle = Unicycle(speed_noise=0.1, yaw_rate_noise=0.05)
    start = Gaussian(vehicle.start(), jnp.diag(jnp.array([0.2, 0.3, 0.1]) ** 2))
    return Rig(vehicle, (Installation("gnss", Gnss(std=std), rate=1.0),), prior or start)


def driven(estimator, begin, end):
    """Fixes of a drive along x at 1 m/s, each second."""
    answers = []
    for second in range(begin, end):
        fix = Measurement(np.array([float(second), 0.0]))
        answers.append(estimator.push(float(second), "gnss", fix))
    return answers


def test_a_reset_is_a_new_estimator_with_that_prior_and_says_how_far_it_jumped():
    estimator = Estimator(ExtendedKalman(), rig(), control=Control(1.0, 0.0), lag=1.0)
    driven(estimator, 1, 6)
    before = estimator.peek(5.0)
    pose = {"position": [4.0, 1.0], "heading": 0.2}
    jump = estimator.reset(pose, {"position": 0.5, "heading": [0.05]})
    assert (jump.time, estimator.resets) == (5.0, 1)
    np.testing.assert_allclose(jump.delta[:2], np.array([4.0, 1.0]) - before.mean.position)
    prior = Gaussian(
        State(jnp.array([4.0, 1.0]), jnp.array(0.2)), jnp.diag(jnp.array([0.25, 0.25, 0.0025]))
    )
    fresh = Estimator(
        ExtendedKalman(), rig(prior), control=Control(1.0, 0.0), lag=1.0, start=5.0
    )
    for one, other in zip(driven(estimator, 6, 9), driven(fresh, 6, 9), strict=True):
        np.testing.assert_allclose(one.moments.mean.position, other.moments.mean.position)
        np.testing.assert_allclose(one.moments.cov, other.moments.cov, rtol=1e-9)


def test_what_is_older_than_a_reset_is_late():
    estimator = Estimator(ExtendedKalman(), rig(), lag=2.0)
    driven(estimator, 1, 6)
    estimator.reset({"heading": 0.0}, time=5.5)
    assert estimator.time == 5.5
    assert estimator.push(5.4, "gnss", Measurement(np.zeros(2))).verdict == Verdict.LATE
    assert estimator.push(5.5, "gnss", Measurement(np.zeros(2))).verdict == Verdict.FUSED


def test_fields_that_are_not_named_stay():
    before = Gaussian(
        State(jnp.array([1.0, 2.0]), jnp.array(0.3)),
        jnp.array([[4.0, 1.0, 0.5], [1.0, 9.0, 0.2], [0.5, 0.2, 0.1]]),
    )
    after = restarted(before, {"heading": 7.0}, {"heading": 0.2})
    np.testing.assert_allclose(after.mean.position, [1.0, 2.0])
    np.testing.assert_allclose(after.mean.heading, 7.0 - 2 * np.pi)
    expected = [[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 0.04]]
    np.testing.assert_allclose(after.cov, expected)


@pytest.mark.parametrize(
    ("mean", "cov", "text"),
    [
        ({"headin": 1.0}, None, "headin: no such field, expected one of position, heading"),
        ({"heading": np.nan}, None, "expected finite numbers"),
        ({"position": [1.0]}, None, "position: found 1 numbers, expected 2 numbers"),
        ({"heading": 0.0}, {"heading": 0.0}, "expected one number above 0"),
        ({"heading": 0.0}, {"place": 1.0}, "place: no such field"),
        ({}, -np.eye(3), "expected a covariance"),
        ({}, np.eye(2), "found 2 x 2 numbers, expected 3 x 3"),
        (Control(1.0, 0.0), None, "expected a state of the vehicle"),
    ],
)
def test_what_is_of_no_use_changes_nothing(mean, cov, text):
    before = Gaussian(State(jnp.zeros(2), jnp.array(0.3)), jnp.eye(3))
    with pytest.raises(DataError, match=text):
        restarted(before, mean, cov)


def test_another_filter_goes_on_from_there():
    estimator = Estimator(ExtendedKalman(), rig(), control=Control(1.0, 0.0))
    driven(estimator, 1, 4)
    before = estimator.peek(3.0)
    estimator.swap(UnscentedKalman())
    np.testing.assert_allclose(estimator.belief.moments().cov, before.cov, rtol=1e-9)
    prior = Gaussian(before.mean, before.cov)
    fresh = Estimator(UnscentedKalman(), rig(prior), control=Control(1.0, 0.0), start=3.0)
    for one, other in zip(driven(estimator, 4, 6), driven(fresh, 4, 6), strict=True):
        np.testing.assert_allclose(one.moments.cov, other.moments.cov, rtol=1e-9)


def test_a_filter_that_cannot_run_the_rig_is_refused_and_the_old_one_goes_on():
    class Broken(ExtendedKalman):
        def init(self, prior, key):
            raise ContractError("not on this rig")

    estimator = Estimator(ExtendedKalman(), rig())
    driven(estimator, 1, 3)
    with pytest.raises(ContractError, match="not on this rig"):
        estimator.swap(Broken())
    assert driven(estimator, 3, 4)[0].verdict == Verdict.FUSED
