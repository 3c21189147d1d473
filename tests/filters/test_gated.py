"""The gate refuses as many good readings as it is told to; what it refuses changes nothing."""

from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import Euclidean
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Installation, Rig
from kedge.filters.extended import ExtendedKalman
from kedge.filters.gated import Gated
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import Unicycle

SIZES = (1, 2, 3, 6)
FALSE_ALARM = {1: 0.01, 2: 0.05, 3: 0.01, 6: 0.001}
RUNS = 40_000

Block = {n: Annotated[Any, Euclidean("m", (n,))] for n in SIZES}
State = NamedTuple("State", [(f"block{n}", Block[n]) for n in SIZES])
Seen = {n: NamedTuple(f"Seen{n}", [(f"block{n}", Block[n])]) for n in SIZES}


class Drift(AbstractVehicle[State, tuple, State]):
    """Blocks of 1, 2, 3 and 6 components that wander apart."""

    def step(self, state, control, noise, dt):
        return State(*(block + push * dt for block, push in zip(state, noise, strict=True)))

    def noise_density(self):
        return State(*(jnp.full(n, 0.7) for n in SIZES))

    def start(self):
        return State(*(jnp.zeros(n) for n in SIZES))

    def drive(self, time):
        return ()


class Gauge(AbstractSensor[Any]):
    """Reads one block."""

    size: int = eqx.field(static=True)

    @property
    def reads(self):
        return Seen[self.size]

    measures = reads

    def observe(self, state):
        return state

    def noise_std(self, state):
        return Seen[self.size](jnp.full(self.size, 0.5))


def test_false_alarms_come_at_the_rate_asked_for():
    """Every reading is matched: drawn from the model, each of a block that no other reads.

    The number refused of so many independent ones is binomial; its 99 % bounds are those of
    scipy. The reading of 6 components goes through a gate with a rarer alarm.
    """
    installations = tuple(
        Installation(f"gauge{n}", Gauge(n), gate=FALSE_ALARM[n]) for n in SIZES
    )
    rig = Rig(Drift(), installations, Gaussian(Drift().start(), 2.0 * jnp.eye(12)))
    events = len(SIZES)
    schedule = Schedule(jnp.ones(events), jnp.arange(events), jnp.zeros(events, int))

    def verdicts(key):
        draws = jr.split(key, events)
        readings = []
        for n, draw in zip(SIZES, draws, strict=True):
            # The prior, a second of wandering, and the gauge's own noise.
            std = np.sqrt(2.0 + 0.7**2 + 0.5**2)
            readings.append(Readings(Seen[n](std * jr.normal(draw, (1, n))), jnp.zeros(1, int)))
        log = Log(schedule, (), tuple(readings))
        return estimate(ExtendedKalman(), rig, log).outcome.verdict

    found = np.asarray(quick_jit(jax.vmap(verdicts))(jr.split(jr.key(5), RUNS)))
    assert set(np.unique(found)) == {Verdict.FUSED, Verdict.GATED}
    for i, n in enumerate(SIZES):
        refused = int((found[:, i] == Verdict.GATED).sum())
        low, high = scipy.stats.binom(RUNS, FALSE_ALARM[n]).ppf([0.005, 0.995])
        assert low <= refused <= high, f"{n} degrees of freedom"


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
