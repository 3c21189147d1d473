"""On a linear Gaussian model the answer is known: the dense joint Gaussian of all states.

The model is written down twice: as a vehicle and a sensor, and as matrices in numpy. Steps,
process noise and measurement noise differ from event to event, so that a filter which uses
another event's Q or R is found out (pykalman did for ten years).
"""

import functools as ft
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractGaussianFilter, AbstractSensor, AbstractVehicle
from kedge.core.quantities import Acceleration, Range, Ratio, Speed
from kedge.core.registry import filters
from kedge.estimation.batch import estimate_with_history
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.parallel import smooth_in_parallel
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.smoother import rauch_tung_striebel, smooth
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.dead_reckoning import DeadReckoning
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.testing import quick_jit

GAUSSIAN = [
    name
    for name in filters.names()
    if issubclass(filters.get(name), AbstractGaussianFilter)
    and name not in ("dead-reckoning", "raw")
]
# Each compiles a program of its own; those that share the least of their code are always run.
FAST = ("kalman", "unscented", "square-root")
each = [n if n in FAST else pytest.param(n, marks=pytest.mark.slow) for n in GAUSSIAN]


class State(NamedTuple):
    position: Range
    speed: Speed


class Control(NamedTuple):
    acceleration: Acceleration
    roughness: Ratio


class Noise(NamedTuple):
    acceleration: Acceleration


class Trolley(AbstractVehicle[State, Control, Noise]):
    """Accelerated on a rail whose roughness, a control, scales the noise."""

    density: float = 0.7

    def step(self, state, control, noise, dt):
        push = control.acceleration + control.roughness * noise.acceleration
        return State(
            state.position + state.speed * dt + push * dt**2 / 2, state.speed + push * dt
        )

    def noise_density(self):
        return Noise(self.density)

    def start(self):
        return State(jnp.array(0.5), jnp.array(-0.2))

    def nominal_control(self, time):
        return Control(jnp.array(0.0), jnp.array(1.0))


class Seen(NamedTuple):
    position: Range


class Rule(AbstractSensor[Seen]):
    """Reads the position."""

    reads = Seen
    measures = Seen

    def observe(self, state):
        return Seen(state.position)

    def noise_std(self, state):
        return Seen(jnp.array(0.4))


DT = np.array([0.3, 0.5, 0.0, 1.0, 0.2, 0.7, 0.4])
SENSOR = np.array([0, -1, 0, 0, -1, 0, 0])
ACCELERATION = np.array([0.2, -1.0, 3.0, 0.4, 0.0, -0.6, 1.1])
ROUGHNESS = np.array([1.0, 0.2, 9.0, 2.5, 0.6, 0.0, 1.7])
R = np.array([0.3, 0.05, 1.5, 0.2, 0.8])
READINGS = np.array([0.7, 0.1, -0.9, 0.3, 1.2])
PRIOR = np.array([[0.9, 0.2], [0.2, 0.4]])


def problem(prior=PRIOR):
    rig = Rig(Trolley(), (Installation("rule", Rule()),), Gaussian(Trolley().start(), prior))
    row = np.cumsum(SENSOR >= 0) - 1
    log = Log(
        Schedule(jnp.cumsum(DT), jnp.asarray(SENSOR), jnp.asarray(np.maximum(row, 0))),
        Control(jnp.asarray(ACCELERATION), jnp.asarray(ROUGHNESS)),
        (
            Readings(
                Seen(jnp.asarray(READINGS)), jnp.zeros(5, int), jnp.asarray(R)[:, None, None]
            ),
        ),
    )
    return rig, log


def joint(prior=PRIOR):
    """Mean and covariance of all states after the events, and the rows that are measured."""
    events = len(DT)
    # x_k as a linear map of the initial state and one noise an event.
    maps, offsets = [], []
    linear, offset = np.hstack([np.eye(2), np.zeros((2, events))]), np.array([0.5, -0.2])
    for k, dt in enumerate(DT):
        F, G = np.array([[1, dt], [0, 1]]), np.array([dt**2 / 2, dt])
        linear, offset = F @ linear, F @ offset + G * ACCELERATION[k]
        linear[:, 2 + k] += G * ROUGHNESS[k]
        maps.append(linear)
        offsets.append(offset)
    sources = np.zeros((2 + events, 2 + events))
    sources[:2, :2] = prior
    sources[2:, 2:] = np.diag([0.7**2 / dt if dt else 0.0 for dt in DT])
    A, b = np.vstack(maps), np.concatenate(offsets)
    return b, A @ sources @ A.T, 2 * np.flatnonzero(SENSOR >= 0)


def posterior(prior=PRIOR, upto=7):
    """All states in the light of the readings at the first ``upto`` events."""
    mean, cov, rows = joint(prior)
    rows = rows[rows < 2 * upto]
    S = cov[np.ix_(rows, rows)] + np.diag(R[: len(rows)])
    K = np.linalg.solve(S, cov[rows]).T
    return mean + K @ (READINGS[: len(rows)] - mean[rows]), cov - K @ cov[rows]


def flat(moments):
    mean = np.stack([moments.mean.position, moments.mean.speed], axis=1)
    return mean, np.asarray(moments.cov)


@ft.cache
def smoother(name):
    return quick_jit(lambda prior: smooth(filters.make(name), *problem(prior)))


@pytest.fixture(params=each)
def run(request):
    return smoother(request.param)(PRIOR)


def test_filter_is_the_joint_posterior_so_far(run):
    mean, cov = flat(run[0].moments)
    for k in range(len(DT)):
        some, here = posterior(upto=k + 1), slice(2 * k, 2 * k + 2)
        np.testing.assert_allclose(mean[k], some[0][here], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(cov[k], some[1][here, here], rtol=1e-10, atol=1e-12)


def test_smoother_is_the_joint_posterior(run):
    mean, cov = flat(run[1].moments)
    some = posterior()
    for k in range(len(DT)):
        here = slice(2 * k, 2 * k + 2)
        np.testing.assert_allclose(mean[k], some[0][here], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(cov[k], some[1][here, here], rtol=1e-9, atol=1e-10)


def test_log_likelihood_is_the_log_of_the_joint_density(run):
    mean, cov, rows = joint()
    density = scipy.stats.multivariate_normal(mean[rows], cov[np.ix_(rows, rows)] + np.diag(R))
    total = run[0].outcome.log_likelihood.sum()
    np.testing.assert_allclose(total, density.logpdf(READINGS), rtol=1e-10)


def test_smoother_ends_where_the_filter_ends(run):
    for filtered, smoothed in zip(*map(flat, (run[0].moments, run[1].moments)), strict=True):
        np.testing.assert_array_equal(smoothed[-1], filtered[-1])


def test_smoothed_covariance_is_never_larger(run):
    gain = flat(run[0].moments)[1] - flat(run[1].moments)[1]
    assert np.linalg.eigvalsh(gain).min() > -1e-12
    assert np.trace(gain[0]) > 0.1  # and it is smaller where later readings tell something


@pytest.mark.parametrize("known", [np.zeros((2, 2)), np.diag([0.0, 0.3])], ids=["all", "place"])
@pytest.mark.parametrize("name", each)
def test_a_start_that_is_known_exactly(name, known):
    """One noise channel drives two states, so covariances stay singular for a while."""
    filtered, smoothed = smoother(name)(known)
    mean, cov = flat(filtered.moments)
    last = posterior(known)
    np.testing.assert_allclose(mean[-1], last[0][-2:], rtol=1e-9)
    np.testing.assert_allclose(cov[-1], last[1][-2:, -2:], rtol=1e-9)
    mean, cov = flat(smoothed.moments)
    for k in range(len(DT)):
        here = slice(2 * k, 2 * k + 2)
        np.testing.assert_allclose(mean[k], last[0][here], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(cov[k], last[1][here, here], rtol=1e-7, atol=1e-7)


def test_scan_is_associative_scan():
    """Law 9, with events without a reading or without time between, and outcomes as well."""
    expected = smoother("kalman")(PRIOR)
    found = quick_jit(lambda prior: smooth_in_parallel(*problem(prior)))(PRIOR)
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_dead_reckoning_is_the_joint_prior():
    @quick_jit
    def run(prior):
        estimates, history = estimate_with_history(DeadReckoning(), *problem(prior))
        return estimates.moments, rauch_tung_striebel(estimates.moments, history).cov

    moments, smoothed = run(PRIOR)
    mean, cov, _ = joint()
    at, spread = flat(moments)
    np.testing.assert_allclose(at.ravel(), mean, rtol=1e-12)
    blocks = [cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(DT))]
    np.testing.assert_allclose(spread, blocks, rtol=1e-12)
    # Nothing was learned, so there is nothing to tell the past.
    np.testing.assert_allclose(smoothed, blocks, rtol=1e-9, atol=1e-12)


def error_of(filter, keys, exact):
    """RMS distance of a sampling filter's mean from the exact one, over ``keys``."""
    rig, _ = problem()
    state = Gaussian(jax.tree.map(jnp.asarray, rig.prior.mean), jnp.asarray(rig.prior.cov))
    model = rig.sensors[0].sensor

    @quick_jit
    @jax.vmap
    def mean(key):
        belief = filter.init(state, jr.fold_in(key, 0))
        control = Control(jnp.array(0.2), jnp.array(1.0))
        belief = filter.predict(rig.vehicle, belief, control, 0.3, jr.fold_in(key, 1))
        belief, _ = filter.update(model, belief, Seen(jnp.array(0.7)), jr.fold_in(key, 2))
        return jnp.stack(belief.moments().mean)

    return np.sqrt(np.mean((mean(keys) - exact[None]) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("make", [EnsembleKalman, BootstrapParticle])
def test_sampling_filters_tend_to_the_kalman_filter(make, key):
    """The error falls with the square root of the number of samples; the slope says so."""
    exact = Kalman()
    prior = Gaussian(State(jnp.array(0.5), jnp.array(-0.2)), jnp.asarray(PRIOR))
    control = Control(jnp.array(0.2), jnp.array(1.0))

    @quick_jit
    def truth():
        belief = exact.predict(Trolley(), prior, control, 0.3, key)
        return exact.update(Rule(), belief, Seen(jnp.array(0.7)), key)[0].mean

    mean = np.array(truth())
    counts = np.array([16, 1024])
    errors = [error_of(make(int(n)), jr.split(key, 150), mean) for n in counts]
    slope = np.diff(np.log(errors))[0] / np.diff(np.log(counts))[0]
    # 150 runs know each RMS to about 5 %, and so the slope over a factor of 64 to about .015.
    assert -0.55 < slope < -0.45
