"""Gates that recover: from a wrong belief they do, by a broken sensor they are not fooled."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.verdicts import Verdict
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Installation, Rig
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.filters.wrappers.gated import Gated
from kedge.filters.wrappers.robust import Robust
from kedge.numerics.losses import Loss
from kedge.sensors import depth, doppler, ranges
from kedge.sensors.depth import Depth
from kedge.sensors.doppler import Doppler
from kedge.sensors.gnss import Gnss, Measurement
from kedge.sensors.ranges import Anchor, Ranges
from kedge.vehicles.body_twist import BodyTwist
from kedge.vehicles.unicycle import Unicycle

AWAY = np.array([100.0, -40.0])


def rig(recovery, gate=0.01, std=0.5):
    sensors = tuple(
        Installation(name, Gnss(std=std), gate=gate, recovery=recovery)
        for name in ("one", "other")
    )
    return Rig(Unicycle(), sensors, Gaussian(Unicycle().start(), 0.1 * jnp.eye(3)))


def verdicts(estimator, readings):
    return [estimator.push(t, name, Measurement(place)) for t, name, place in readings]


@pytest.mark.parametrize(
    "filter",
    [ExtendedKalman(), EnsembleKalman(count=40), BootstrapParticle(count=200)],
    ids=["extended", "ensemble", "particle"],
)
def test_a_wrong_belief_is_given_up_after_the_time_set(filter, key):
    """The start is 108 m off: refused for 5 s, then the state goes where the readings are."""
    estimator = Estimator(filter, rig(5.0), key)
    answers = verdicts(estimator, [(float(t), "one", AWAY) for t in range(1, 10)])
    assert [a.verdict for a in answers[:5]] == [Verdict.GATED] * 5
    assert not any(a.outcome.recovered for a in answers[:5])
    assert answers[5].verdict == Verdict.FUSED
    assert answers[5].outcome.recovered
    if not isinstance(filter, BootstrapParticle):
        place = estimator.belief.moments().mean.position
        assert np.linalg.norm(place - AWAY) < 1.5
    else:  # widened particles come near; weighing does the rest as far as they reach
        place = estimator.belief.moments().mean.position
        assert np.linalg.norm(place - AWAY) < 60


def test_it_recovers_unless_that_is_switched_off(key):
    readings = [(float(t), "one", AWAY) for t in range(1, 13)]
    for recovery, after in ((None, Verdict.FUSED), (math.inf, Verdict.GATED)):
        estimator = Estimator(ExtendedKalman(), rig(recovery), key)
        seen = [answer.verdict for answer in verdicts(estimator, readings)]
        assert seen == [Verdict.GATED] * 10 + [after] * 2


def test_the_innovation_after_a_reset_is_as_large_as_it_is_expected_to_be(key):
    r"""The covariance grows by NIS / dof, so that $\nu^\top S^{-1} \nu$ is about dof then."""
    estimator = Estimator(ExtendedKalman(), rig(1.0, std=0.001), key)
    answers = verdicts(estimator, [(float(t), "one", AWAY) for t in range(1, 4)])
    recovered = next(a.outcome for a in answers if a.outcome.recovered)
    assert recovered.nis == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("wrapped", [False, True], ids=["sensor", "filter"])
def test_a_depth_is_let_in_while_a_doppler_log_works(wrapped, key):
    """The log says nothing of the depth, which is 20 m off; another depth sensor does."""
    gate = None if wrapped else 1e-4
    sensors = (
        Installation("dvl", Doppler(std=0.02), gate=gate),
        Installation("depth", Depth(std=0.05), gate=gate),
        Installation("second", Depth(std=0.05), gate=gate),
    )
    vehicle = BodyTwist(acceleration_noise=0.05, angular_noise=0.001)
    rig = Rig(vehicle, sensors, Gaussian(vehicle.start(), 1e-5 * jnp.eye(12)))
    filter = Gated(ExtendedKalman(), 1e-4) if wrapped else ExtendedKalman()

    def last_verdicts(second):
        estimator, seen = Estimator(filter, rig, key), []
        for tick in range(1, 61):
            time, speed = 0.25 * tick, np.asarray(vehicle.start().velocity_body)
            log = estimator.push(time, "dvl", doppler.Measurement(speed))
            assert log.verdict == Verdict.FUSED
            if second:
                estimator.push(time, "second", depth.Measurement(np.asarray(0.0)))
            seen.append(estimator.push(time, "depth", depth.Measurement(np.asarray(20.0))))
        assert {a.verdict for a in seen[:40]} == {Verdict.GATED}
        return {answer.verdict for answer in seen[44:]}

    assert last_verdicts(second=False) == {Verdict.FUSED}
    assert last_verdicts(second=True) == {Verdict.GATED}


@pytest.mark.parametrize("wrapped", [False, True], ids=["sensor", "filter"])
def test_a_robust_loss_comes_back_from_fixes_that_were_far_off(wrapped, key):
    """24 s of fixes 780 m off lead it astray; 10 s of good ones bring it back."""
    loss = None if wrapped else Loss("student")
    sensor = Installation("gnss", Gnss(std=0.5), robust=loss)
    rig = Rig(Unicycle(), (sensor,), Gaussian(Unicycle().start(), 0.1 * jnp.eye(3)))
    filter = Robust(ExtendedKalman()) if wrapped else ExtendedKalman()
    estimator = Estimator(filter, rig, key)
    distance = []
    for time in range(1, 120):
        fix = np.array([780.0, 0.0]) if 20 < time <= 44 else np.zeros(2)
        moments = estimator.push(float(time), "gnss", Measurement(fix)).moments
        distance.append(np.linalg.norm(moments.mean.position))
    assert max(distance) > 700
    assert max(distance[60:]) < 3


def test_anchors_that_were_heard_confirm_a_position(key):
    """Ranges to three anchors stand against a fix far off, whichever was heard last."""
    anchors = np.array([[30.0, 0.0], [0.0, 30.0], [-30.0, -30.0]])
    uwb = Ranges(target=Anchor(jnp.asarray(anchors)), range_std=0.1)
    sensors = (
        Installation("ranges", uwb),
        Installation("gnss", Gnss(std=0.5), gate=0.01, recovery=2.0),
    )
    rig = Rig(Unicycle(), sensors, Gaussian(Unicycle().start(), 0.1 * jnp.eye(3)))
    estimator = Estimator(ExtendedKalman(), rig, key)
    # Equally far from the third anchor as the origin is.
    far = np.array([-60.0, -60.0])
    for tick in range(3, 61):
        place = estimator.belief.moments().mean.position
        heard = np.linalg.norm(np.asarray(place) - anchors[tick % 3])
        estimator.push(tick / 3, "ranges", ranges.Measurement(heard), target=tick % 3)
        seen = estimator.push(tick / 3, "gnss", Measurement(far))
        assert seen.verdict == Verdict.GATED


def test_a_broken_sensor_does_not_win_against_one_that_agrees(key):
    """Refusals count only while nothing is fused: here the other sensor is."""
    estimator = Estimator(ExtendedKalman(), rig(5.0), key)
    for t in range(1, 20):
        here = estimator.push(float(t)).moments.mean.position
        good = estimator.push(float(t), "other", Measurement(np.asarray(here)))
        bad = estimator.push(float(t), "one", Measurement(AWAY))
        assert (good.verdict, bad.verdict) == (Verdict.FUSED, Verdict.GATED)


def test_one_outlier_after_a_long_silence_is_refused(key):
    estimator = Estimator(ExtendedKalman(), rig(5.0), key)
    estimator.push(1.0, "one", Measurement(np.zeros(2)))
    assert estimator.push(60.0, "one", Measurement(100 * AWAY)).verdict == Verdict.GATED


def test_the_wrapper_recovers_alone(key):
    """The same as a filter around a filter: without sensors of a rig that say so."""
    estimator = Estimator(Gated(ExtendedKalman(), 0.01, recovery=5.0), rig(None, None), key)
    answers = verdicts(estimator, [(float(t), "one", AWAY) for t in range(1, 10)])
    assert [a.verdict for a in answers] == [Verdict.GATED] * 5 + [Verdict.FUSED] * 4
    assert np.linalg.norm(estimator.belief.moments().mean.position - AWAY) < 1.0


def test_a_recovery_needs_a_gate_and_a_time():
    with pytest.raises(ContractError, match="'one': recovery is 5 s, but there is no gate"):
        rig(5.0, gate=None)
    with pytest.raises(ContractError, match="recovery is 0 s, must be above 0; inf is never"):
        Gated(recovery=0.0)
