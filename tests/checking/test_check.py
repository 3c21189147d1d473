"""A check of simulated logs, clean ones and such with one thing wrong."""

import jax
import pytest

from kedge.checking.advice import findings
from kedge.checking.check import check
from kedge.checking.planted import PLANTED, planted
from kedge.filters.gaussian.extended import ExtendedKalman

SEED = 7001  # none that a threshold was chosen on

pytestmark = pytest.mark.slow


def wrong(fault, key=SEED):
    recording, rig = planted(fault, jax.random.key(key))
    return findings(check(ExtendedKalman(), rig, recording), {})


@pytest.mark.parametrize("fault", PLANTED)
def test_what_is_planted_is_detected_and_nothing_else(fault):
    assert {(one.kind, one.subject) for one in wrong(fault)} == {PLANTED[fault]}


def test_nothing_is_wrong_with_a_good_log():
    assert wrong(None) == []


def test_the_value_that_is_advised_mends_it():
    (one,) = wrong("clock off by 0.15 s")
    assert one.value == pytest.approx(0.15, abs=0.03)
    assert one.advice.startswith("[sensors.radio] latency = 0.1")
    (one,) = wrong("odometry scale 5 % off")
    assert one.value == pytest.approx(1 / 0.95 - 1, abs=0.02)
    assert one.advice.startswith("multiply the column of control.speed by 0.95")
