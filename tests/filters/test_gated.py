"""The gate refuses as many good readings as it is told to; what it refuses changes nothing."""

from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor
from kedge.core.errors import ContractError
from kedge.core.manifolds import Euclidean
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Readings
from kedge.estimation.rig import Installation
from kedge.estimation.step import FilterState, process_measurement
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.wrappers.gated import Gated
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import Unicycle

RUNS = 40_000


class State(NamedTuple):
    offset: Annotated[Any, Euclidean("m", (6,))]


class Gauge(AbstractSensor[State]):
    """Reads all six components."""

    reads = State
    measures = State

    def observe(self, state):
        return state

    def noise_std(self, state):
        return State(jnp.array([0.1, 0.5, 1.0, 2.0, 0.3, 1.5]))


def test_false_alarms_come_at_the_rate_asked_for():
    """Matched readings: drawn from a correlated prior and the gauge's own noise.

    The number refused of so many independent ones is binomial; its 99 % bounds are scipy's. A
    reading of 1, 2 or 3 components is one of 6 with the others missing, as in a log.
    """
    factor = np.random.default_rng(1).normal(size=(6, 6))
    prior = Gaussian(State(jnp.zeros(6)), jnp.asarray(factor @ factor.T))
    gauge = Installation("gauge", Gauge(), gate=0.01)
    spread = jnp.linalg.cholesky(prior.cov + gauge.noise_cov(prior.mean, jnp.asarray(0)))

    @quick_jit
    @jax.vmap
    @jax.vmap
    def verdict(white, present):
        seen = State(jnp.where(present, spread @ white, jnp.nan))
        reading = Readings(seen, jnp.asarray(0))
        _, outcome = process_measurement(
            ExtendedKalman(), (gauge,), 0, FilterState(prior), reading, jr.key(0)
        )
        return outcome.verdict, outcome.dof

    patterns = np.array([[0, 0, 1, 0, 0, 0], [1, 0, 0, 0, 1, 0], [0, 1, 0, 1, 1, 0], [1] * 6])
    draws = np.random.default_rng(2).normal(size=(4, RUNS, 6))
    found, dof = verdict(draws, np.broadcast_to(patterns[:, None] == 1, draws.shape))
    np.testing.assert_array_equal(dof[:, 0], [1, 2, 3, 6])
    refused = (np.asarray(found) == Verdict.GATED).sum(axis=1)
    assert ((np.asarray(found) == Verdict.FUSED).sum(axis=1) == RUNS - refused).all()
    low, high = scipy.stats.binom(RUNS, 0.01).ppf([0.005, 0.995])
    assert (low <= refused).all(), refused
    assert (refused <= high).all(), refused


@pytest.mark.parametrize("false_alarm", [0.2, 0.01, 1e-6])
def test_the_bound_follows_from_what_is_there(false_alarm, key):
    """A reading with a component missing has fewer degrees of freedom, so a lower bound."""
    belief = Gaussian(Unicycle().start(), jnp.eye(3))

    class Partly(Gnss):
        present: Any = 2

        def dof(self):
            return self.present

    @quick_jit
    def threshold(present):
        seen = Measurement(jnp.zeros(2))
        gate = Gated(ExtendedKalman(), false_alarm)
        return gate.update(Partly(present=present), belief, seen, key)[1].threshold

    for present in (1, 2):
        expected = scipy.stats.chi2(present).isf(false_alarm)
        np.testing.assert_allclose(threshold(present), expected, rtol=1e-9)
    assert threshold(0) == np.inf


def test_what_falls_outside_changes_nothing(key):
    belief = Gaussian(Unicycle().start(), 0.5 * jnp.eye(3))
    gate = Gated(ExtendedKalman(), 0.01)
    update = quick_jit(lambda x: gate.update(Gnss(std=1.0), belief, Measurement(x), key))
    # S = 1.5 I: the edge lies where x^2 / 1.5 is the chi-square bound of two components.
    edge = np.sqrt(1.5 * scipy.stats.chi2(2).isf(0.01))
    kept, outside = update(np.array([edge * (1 + 1e-9), 0.0]))
    moved, inside = update(np.array([edge * (1 - 1e-9), 0.0]))
    assert not outside.accepted
    assert inside.accepted
    np.testing.assert_array_equal(kept.cov, belief.cov)
    np.testing.assert_array_equal(kept.mean.position, [0, 0])
    np.testing.assert_allclose(moved.mean.position, [edge / 3, 0], rtol=1e-8)


@pytest.mark.parametrize("false_alarm", [0.0, 1.0, -0.1, 99.0])
def test_a_gate_is_set_by_a_probability(false_alarm):
    with pytest.raises(ContractError, match=r"must be between 0 and 1.*e\.g\. 0\.01"):
        Gated(ExtendedKalman(), false_alarm)
