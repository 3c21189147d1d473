"""Health: repairs, depletion and recoveries are counted and said, never silent."""

import math
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates, estimate
from kedge.estimation.log import Log, Readings, Recording, Schedule
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.health import concerns, health, smallest_eigenvalue
from kedge.evaluation.refusals import refusals, sentences
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.unscented import UnscentedKalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.sensors.gnss import Gnss, Measurement
from kedge.vehicles.constant_velocity import ConstantVelocity, Control


def made(filter, places, std=1.0, spread=1.0, **given):
    vehicle = ConstantVelocity(acceleration_noise=0.1)
    sensor = Installation("gnss", Gnss(std=std), **given)
    rig = Rig(vehicle, (sensor,), Gaussian(vehicle.start(), spread * jnp.eye(4)))
    count = len(places)
    log = Log(
        Schedule(1.0 + np.arange(count), np.zeros(count, int), np.arange(count)),
        Control(*(jnp.zeros(count) for _ in Control._fields)),
        (Readings(Measurement(np.asarray(places)), np.zeros(count, int)),),
    )
    return estimate(filter, rig, log), rig, log


def run(filter, places, **given):
    return made(filter, places, **given)[0]


def verdicts(estimates):
    return Counter(Verdict(int(v)).name for v in np.asarray(estimates.outcome.verdict))


def test_a_gaussian_that_stays_one_has_nothing_to_say():
    estimates = run(UnscentedKalman(), np.zeros((3, 2)))
    found = health(estimates)
    assert (found.repairs, found.recoveries) == (0, 0)
    assert 0 < found.smallest_eigenvalue <= 1
    assert found.effective_size is None
    assert concerns("unscented", found, verdicts(estimates)) == []


def test_particles_that_explain_nothing_are_a_status():
    """Within the cloud, beside it, beyond what numbers can say: left out, and it is said."""
    places = np.array([[1.0, 0.5], [1e200, 0.0], [3.0, 1.5], [1e4, 0.0]])
    estimates = run(BootstrapParticle(count=50), places)
    found = health(estimates)
    assert found.depleted == 1
    assert found.effective_size.min == 0
    assert 0 < found.effective_size.median <= 50
    assert np.isfinite(estimates.moments.cov).all()
    widened, left_out, luck = concerns("particle", found, verdicts(estimates))
    assert found.repairs == 1
    assert "at 1 readings the particles were resampled into so few places" in widened
    assert "no particle explained 1 of 4 readings" in left_out
    assert "at 1 readings one particle carried nearly all" in luck


def test_a_recovery_is_counted():
    places = np.tile([500.0, 0.0], (8, 1))
    found = health(run(ExtendedKalman(), places, gate=0.01, recovery=4.0))
    assert found.recoveries == 1


@pytest.mark.parametrize(
    ("count", "recovery", "expected"),
    [
        (8, 4.0, "gps: after nothing but outliers of gnss one was let in at 5.0 s."),
        (15, math.inf, "for 14.0 s, from 1.0 s on (the longest of 1); none was let in."),
    ],
)
def test_a_sensor_that_is_locked_out_is_said(count, recovery, expected):
    places = np.tile([500.0, 0.0], (count, 1))
    estimates, rig, log = made(ExtendedKalman(), places, gate=0.01, recovery=recovery)
    recording = Recording(log, 0, np.zeros(count, int), np.zeros(0, int))
    (said,) = sentences("gps", refusals(estimates, recording, rig))
    assert said.endswith(expected)


def test_the_eigenvalue_is_that_of_the_correlations():
    cov = np.array([[[4.0, 1.0], [1.0, 1.0]], [[1e12, 0.0], [0.0, 1e-12]], np.diag([0.0, 2.0])])
    assert smallest_eigenvalue(cov) == pytest.approx(0.5)  # 1 - 1 / (2 * 1)
    indefinite = np.array([[[1.0, 2.0], [2.0, 1.0]]])
    assert smallest_eigenvalue(indefinite) == pytest.approx(-1.0)


def test_repairs_and_indefinite_covariances_are_said():
    outcome = run(UnscentedKalman(), np.zeros((2, 2))).outcome
    outcome = outcome._replace(repairs=jnp.array([0, 3]))
    cov = jnp.broadcast_to(jnp.array([[1.0, 2.0], [2.0, 1.0]]), (2, 2, 2))
    estimates = Estimates(jnp.zeros(2), Gaussian(None, cov), outcome)
    said = concerns("unscented", health(estimates), {})
    assert "repaired 3 times" in said[0]
    assert "least eigenvalue of its correlations is -1.0e+00" in said[1]
    assert jax.tree.leaves(outcome)
