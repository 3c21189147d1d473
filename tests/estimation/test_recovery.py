"""Gates that recover: from a wrong belief they do, by a broken sensor they are not fooled."""

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
from kedge.sensors.gnss import Gnss, Measurement
from kedge.vehicles.unicycle import Unicycle

AWAY = np.array([100.0, -40.0])


def rig(recovery, gate=0.01):
    sensors = tuple(
        Installation(name, Gnss(std=0.5), gate=gate, recovery=recovery)
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


def test_without_it_a_gate_locks_out_for_ever(key):
    estimator = Estimator(ExtendedKalman(), rig(None), key)
    answers = verdicts(estimator, [(float(t), "one", AWAY) for t in range(1, 10)])
    assert {a.verdict for a in answers} == {Verdict.GATED}


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
    with pytest.raises(ContractError, match="recovery is 0 s, must be above 0 and finite"):
        Gated(recovery=0.0)
