"""A gate that gives way to heavy tails when it refuses too much."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Installation, Rig
from kedge.filters.wrappers.gate_or_student import GateOrStudent
from kedge.filters.wrappers.gated import Gated
from kedge.filters.wrappers.robust import Robust
from kedge.sensors.gnss import Gnss, Measurement
from kedge.vehicles.still import State, Still

COUNT = 60


def run(filter, fixes):
    """A thing that stands, believed at the origin to 10 cm, with a fix of 10 cm each second."""
    prior = Gaussian(State(jnp.zeros(2)), 0.01 * jnp.eye(2))
    rig = Rig(Still(walk=0.01), (Installation("gnss", Gnss(std=0.1)),), prior)
    log = Log(
        Schedule(jnp.arange(1.0, COUNT + 1.0), jnp.zeros(COUNT, int), jnp.arange(COUNT)),
        Still().nominal_control(0.0),
        (Readings(Measurement(jnp.asarray(fixes)), jnp.zeros(COUNT, int)),),
    )
    found = estimate(filter, rig, log)
    return np.asarray(found.moments.mean.position), np.asarray(found.outcome.verdict)


def noise():
    return 0.1 * np.random.default_rng(2).standard_normal((COUNT, 2))


def test_it_is_a_gate_where_outliers_are_rare():
    fixes = noise()
    fixes[[20, 40]] += 30.0
    ours, verdicts = run(GateOrStudent(window=10.0), fixes)
    gated, _ = run(Gated(recovery=math.inf), fixes)
    np.testing.assert_allclose(ours, gated, atol=1e-9)
    assert (verdicts[[20, 40]] == Verdict.GATED).all()


def test_it_is_a_student_where_the_belief_is_wrong():
    """Everything is 30 m from where it was believed: a gate stays there for ever."""
    fixes = noise() + 30.0
    ours, verdicts = run(GateOrStudent(window=10.0), fixes)
    gated, _ = run(Gated(recovery=math.inf), fixes)
    student, _ = run(Robust(recovery=math.inf), fixes)
    assert np.abs(gated).max() < 1.0
    assert verdicts[0] == Verdict.GATED
    assert (verdicts[1:50] == Verdict.FUSED).all()
    np.testing.assert_allclose(ours[4], student[4], atol=0.1)  # heavy tails at first
    assert np.linalg.norm(student[-1] - 30.0) > 1.0  # which do not go there either
    # The sixth fix of nothing but refusals is let in.
    assert np.linalg.norm(ours[6] - 30.0) < 1.0
    assert np.linalg.norm(ours[-1] - 30.0) < 0.1


def test_it_is_a_gate_again_once_the_belief_is_right():
    fixes = noise() + 30.0
    fixes[55] += 30.0
    _, verdicts = run(GateOrStudent(window=5.0), fixes)
    assert verdicts[55] == Verdict.GATED


@pytest.mark.parametrize(
    "wrong", [{"share": 1.0}, {"false_alarm": 0.0}, {"window": 0.0}, {"tuning": -1.0}]
)
def test_settings_that_make_no_sense(wrong):
    with pytest.raises(ContractError, match=next(iter(wrong))):
        GateOrStudent(**wrong)
