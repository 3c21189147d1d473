"""Every reading gets a verdict, and one that is not fused changes nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor
from kedge.core.registry import filters
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Readings
from kedge.estimation.rig import Installation
from kedge.estimation.step import FilterState, process_measurement
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.gnss import Gnss, Measurement
from kedge.sensors.gnss3 import Gnss3
from kedge.sensors.landmarks import Landmarks
from kedge.sensors.landmarks import Measurement as Sight
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import Unicycle

BELIEF = Gaussian(Unicycle().start(), 0.1 * jnp.eye(3))
GATED = Installation("camera", Landmarks(), gate=0.01)
PLAIN = Installation("gnss", Gnss())
WIDE = Installation("wide", Gnss3())
# What the camera sees of the first landmark, 20 m east and 30 m north of the start.
GOOD = (np.hypot(20.0, 30.0), np.arctan2(30.0, 20.0))
R = np.array([[0.25, 0.001], [0.001, 0.0004]])


def take(filter, installation, belief, reading, *others):
    """One reading on its own: the belief after it, and what became of it."""
    state, outcome = process_measurement(
        filter, (installation, *others), 0, FilterState(belief), reading, jax.random.key(0)
    )
    return state.belief, outcome


@pytest.fixture(scope="module")
def camera():
    @quick_jit
    def judge(distance, bearing, target, cov):
        reading = Readings(Sight(distance, bearing), target, cov)
        return take(ExtendedKalman(), GATED, BELIEF, reading, WIDE)

    def run(distance=GOOD[0], bearing=GOOD[1], target=0, cov=R):
        return judge(*map(np.asarray, (distance, bearing, target, cov)))

    return run


def off(index, value, cov=R):
    spoilt = cov.copy()
    spoilt[index] = value
    return spoilt


CASES = {
    "good": ({}, "FUSED"),
    "a little off": ({"distance": GOOD[0] + 0.5}, "FUSED"),
    "turned round": ({"bearing": GOOD[1] + 2 * np.pi}, "FUSED"),
    "no range": ({"distance": np.nan}, "FUSED"),
    "no bearing": ({"bearing": np.nan}, "FUSED"),
    "far off": ({"distance": GOOD[0] + 50}, "GATED"),
    "absurd": ({"distance": 1e300}, "GATED"),
    "nothing": ({"distance": np.nan, "bearing": np.nan}, "NOT_FINITE"),
    "infinite": ({"distance": np.inf}, "NOT_FINITE"),
    "minus infinite": ({"distance": -np.inf, "bearing": np.nan}, "NOT_FINITE"),
    "stranger": ({"target": -1}, "UNKNOWN_TARGET"),
    "off the map": ({"target": 3}, "UNKNOWN_TARGET"),
    "infinite stranger": ({"target": -1, "distance": np.inf}, "UNKNOWN_TARGET"),
    "negative variance": ({"cov": off((0, 0), -0.1)}, "BAD_COVARIANCE"),
    "no variance": ({"cov": off((0, 0), 0.0)}, "BAD_COVARIANCE"),
    "indefinite": ({"cov": off(([0, 1], [1, 0]), 0.1)}, "BAD_COVARIANCE"),
    "one-sided": ({"cov": off((0, 1), 0.1)}, "BAD_COVARIANCE"),
    "other-sided": ({"cov": off((1, 0), 0.1)}, "BAD_COVARIANCE"),
    "unknown variance": ({"cov": off((1, 1), np.nan)}, "BAD_COVARIANCE"),
    # What drivers write for a component that is not there, and for what they do not know.
    "infinite variance": ({"cov": off((1, 1), np.inf)}, "FUSED"),
    "nothing known": ({"cov": np.zeros((2, 2))}, "FUSED"),
    "not there": ({"cov": np.diag([-1.0, 0.0])}, "NOT_FINITE"),
    # The covariance of what is missing is nobody's business.
    "no range, no variance": ({"distance": np.nan, "cov": off((0, 0), np.nan)}, "FUSED"),
    "no range, half a covariance": (
        {"distance": np.nan, "cov": off(([0, 0, 1], [0, 1, 0]), np.nan)},
        "FUSED",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_verdict(camera, case):
    reading, verdict = CASES[case]
    belief, outcome = camera(**reading)
    assert Verdict(int(outcome.verdict)).name == verdict
    changed = not np.array_equal(belief.cov, BELIEF.cov)
    assert changed == (verdict == "FUSED")
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(belief))
    # What was judged by its size is on record; of the rest there is nothing to say.
    judged = verdict in ("FUSED", "GATED")
    assert np.isnan(outcome.nis) != judged
    assert (int(outcome.dof) > 0) == judged
    assert np.isfinite(outcome.threshold) == judged
    assert (float(outcome.log_likelihood) != 0) == (verdict == "FUSED")


def test_what_was_judged_is_on_record_by_component(camera):
    _, outcome = camera(distance=np.nan, bearing=GOOD[1] + 0.01)
    np.testing.assert_allclose(outcome.residual[1], 0.01, rtol=1e-9)
    np.testing.assert_allclose(outcome.white[1] ** 2, outcome.nis)
    np.testing.assert_allclose(outcome.residual[1] / outcome.std[1], outcome.white[1])
    # The range is missing; the third column is padding, for a wider sensor on the rig.
    for values in (outcome.residual, outcome.std, outcome.white):
        np.testing.assert_array_equal(np.isnan(values), [True, False, True])


def test_a_covariance_that_comes_along_replaces_the_sensors_own(camera):
    """Twice the information of a covariance is that of half of it."""
    own = GATED.noise_cov(BELIEF.mean, jnp.asarray(0))
    wide, _ = camera(cov=2 * np.asarray(own))
    narrow, _ = camera(cov=np.asarray(own))
    information = [np.linalg.inv(b.cov) - 10 * np.eye(3) for b in (wide, narrow)]
    np.testing.assert_allclose(2 * information[0], information[1], atol=1e-6)


@pytest.mark.parametrize("std", [0.0, np.nan])
def test_a_sensor_that_breaks_down_is_told_from_a_gated_reading(std, key):
    """An update that cannot be computed has no NIS: beyond no gate, and within none."""

    class Broken(AbstractSensor[Measurement]):
        """Reads the position, for ever the same."""

        reads = Measurement
        measures = Measurement

        def observe(self, state):
            return Measurement(0 * state.position)

        def noise_std(self, state):
            return Measurement(jnp.full(2, std))

    reading = Readings(Measurement(jnp.ones(2)), jnp.asarray(0))
    for gate in (None, 0.01):
        installation = Installation("broken", Broken(), gate=gate)
        belief, outcome = quick_jit(
            lambda belief, i=installation: take(ExtendedKalman(), i, belief, reading)
        )(BELIEF)
        assert Verdict(int(outcome.verdict)) == Verdict.NOT_FINITE
        np.testing.assert_array_equal(belief.cov, BELIEF.cov)


def test_what_a_filter_leaves_out_on_purpose_is_dropped(key):
    reading = Readings(Measurement(jnp.ones(2)), jnp.asarray(0))
    belief, outcome = quick_jit(
        lambda belief: take(filters.make("dead-reckoning"), PLAIN, belief, reading)
    )(BELIEF)
    assert Verdict(int(outcome.verdict)) == Verdict.DROPPED
    np.testing.assert_allclose(outcome.nis, 2 / 1.1)
    np.testing.assert_array_equal(belief.cov, BELIEF.cov)
