"""Ensemble filters against the Kalman filter of their own sample moments (laws 3 and 4)."""

import functools as ft
import math

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.config.filters import build_filter
from kedge.config.scenarios import load_scenario
from kedge.core.beliefs import Ensemble, Gaussian
from kedge.core.contracts import AbstractMeasurementModel
from kedge.core.registry import filters
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.runs import estimate_runs
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.sensors.components import Components
from kedge.studies.study import Study
from kedge.studies.trials import run_study
from kedge.testing import quick_jit
from kedge.vehicles.benchmarks.lorenz96 import Lorenz96, ring
from kedge.vehicles.constant_velocity import ConstantVelocity, Control
from kedge.vehicles.constant_velocity import State as Planar

NAMES = [
    name for name in filters.names() if issubclass(filters.get(name), AbstractEnsembleFilter)
]
DETERMINISTIC = ["etkf", "serial-enkf"]
# Members more and fewer than measured components and than dimensions, in every combination.
SIZES = [
    (4, 10, 2),
    (12, 8, 12),
    *(pytest.param(s, marks=pytest.mark.slow) for s in [(5, 20, 5), (12, 5, 3), (3, 2, 1)]),
]
PLACES = {2: (0, 2), 5: (0, 1, 2, 3, 4), 3: (1, 4, 7), 12: tuple(range(12)), 1: (2,)}


class Correlated(AbstractMeasurementModel):
    """A sensor with a full covariance, known only as such."""

    sensor: Components
    cov: jax.Array

    def expect(self, state):
        return self.sensor.observe(state)

    def noise_cov(self, state):
        return self.cov

    def distances(self, state):
        return self.sensor.distances(state)

    def dof(self):
        return self.sensor.dof()


def case(size, count, measured):
    """Members with correlations, a sensor with correlated noise, and a reading."""
    rng = np.random.default_rng(size * count)
    members = rng.normal(size=(count, size)) @ rng.normal(size=(size, size)) + 1.0
    root = rng.normal(size=(measured, measured)) + 2 * np.eye(measured)
    sensor = Components(size=max(size, 1), indices=PLACES[measured], std=0.7)
    reading = sensor.measures(jnp.asarray(rng.normal(size=measured)))
    belief = Ensemble.of(class_of(size)(jnp.asarray(members)))
    return belief, sensor, Correlated(sensor, jnp.asarray(root @ root.T)), reading


@ft.cache
def class_of(size):
    return ring(size)


def kalman(members, places, noise_cov, reading):
    """The textbook update of the sample moments; also residual, its covariance and density."""
    mean, cov = members.mean(axis=0), np.cov(members.T)
    H = np.eye(members.shape[1])[list(places)]
    S = H @ cov @ H.T + noise_cov
    K = cov @ H.T @ np.linalg.inv(S)
    residual = reading - H @ mean
    nis = residual @ np.linalg.solve(S, residual)
    log_det = np.linalg.slogdet(2 * np.pi * S)[1]
    return mean + K @ residual, cov - K @ H @ cov, S, nis, -0.5 * (nis + log_det), K, H, cov


def updates(models, **parameters):
    """One compiled program with the update of every filter for every model."""

    def run(belief, reading, key):
        return {
            (name, index): filters.make(
                name, count=belief.members.values.shape[0], **parameters
            ).update(model, belief, reading, key)
            for name in NAMES
            for index, model in enumerate(models)
        }

    return quick_jit(run)


@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_updates_are_the_kalman_filters_of_the_sample(sizes, key):
    belief, sensor, correlated, reading = case(*sizes)
    members, z = np.asarray(belief.members.values), np.asarray(reading[0])
    found = updates([sensor, correlated], rotation=True)(belief, reading, key)
    for index, noise_cov in enumerate((0.49 * np.eye(len(z)), np.asarray(correlated.cov))):
        mean, cov, S, nis, density, K, H, before = kalman(members, sensor.chosen, noise_cov, z)
        close = ft.partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9)
        for name in NAMES:
            after, score = found[name, index]
            moments = after.moments()
            assert score.accepted
            close(score.cov, S)
            close(score.nis, nis)
            close(score.log_likelihood, density)
            close(score.residual, z - H @ members.mean(axis=0))
            # Law 3, which the transformations could break only through the mean.
            close(moments.cov, np.cov(np.asarray(after.members.values).T))
            if name != "enkf-n":
                close(moments.mean.values, mean)
            if name in DETERMINISTIC:
                close(moments.cov, cov)
        rest = np.eye(len(cov)) - K @ H / 2
        close(found["denkf", index][0].moments().cov, rest @ before @ rest.T)


@pytest.mark.parametrize("sizes", SIZES[1:], ids=str)
def test_an_endless_radius_is_none(sizes, key):
    """Local analyses and tapers that reach everywhere are the global update."""
    belief, sensor, _, reading = case(*sizes)
    near = updates([sensor], radius=1e9)(belief, reading, key)
    all_at_once = updates([sensor])(belief, reading, key)
    for name in NAMES:
        (after, score), (expected, other) = near[name, 0], all_at_once[name, 0]
        np.testing.assert_allclose(score.nis, other.nis, rtol=1e-6)
        for one, two in zip(after.moments(), expected.moments(), strict=True):
            one, two = np.asarray(jax.tree.leaves(one)[0]), np.asarray(jax.tree.leaves(two)[0])
            np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-6)


def test_what_is_far_stays(key):
    """Beyond the radius not a bit changes; within it, no more than without localisation."""
    belief, _, _, _ = case(12, 5, 3)
    sensor = Components(size=12, indices=(5,), std=0.1)
    reading = sensor.measures(jnp.array([3.0]))
    found = updates([sensor], radius=3.0)(belief, reading, key)
    far = [i for i in range(12) if abs(i - 5) >= 3]
    for name in NAMES:
        after, score = found[name, 0]
        moved = np.abs(np.asarray(after.members.values - belief.members.values)).max(axis=0)
        np.testing.assert_allclose(moved[far], 0, atol=1e-13, err_msg=name)
        assert moved[5] > 0.1
        assert np.isfinite(score.nis)


@pytest.mark.slow
def test_missing_components_change_nothing(key):
    """Law 6: masked as the driver masks them, an update is that of what is there."""
    belief, sensor, _, reading = case(12, 8, 12)
    present = np.arange(12) % 3 != 0
    few = Components(size=12, indices=tuple(np.flatnonzero(present).tolist()), std=0.7)

    class Masked(Correlated):
        def expect(self, state):
            return type(reading)(jnp.where(present, state.values, 0.0))

        def noise_variance(self, state):
            return jnp.where(present, 0.49, 1.0)

        def dof(self):
            return int(present.sum())

    filled = type(reading)(jnp.where(present, reading[0], 0.0))
    masked = updates([Masked(sensor, jnp.eye(12))])(belief, filled, key)
    reduced = updates([few])(belief, few.measures(reading[0][present]), key)
    for name in set(NAMES) - {"ensemble"}:  # its draws depend on the measurement's size
        (after, score), (expected, other) = masked[name, 0], reduced[name, 0]
        np.testing.assert_allclose(after.members.values, expected.members.values, atol=1e-9)
        np.testing.assert_allclose(score.nis, other.nis, rtol=1e-9)
        np.testing.assert_allclose(score.log_likelihood, other.log_likelihood, rtol=1e-9)


@pytest.mark.parametrize("count", [3, pytest.param(12, marks=pytest.mark.slow)])
def test_an_ensemble_without_spread_refuses_readings(count, key):
    """It cannot learn, and says so; nothing becomes NaN."""
    sensor = Components(size=4)
    belief = Ensemble.of(ring(4)(jnp.ones((count, 4))))
    reading = sensor.measures(jnp.zeros(4))
    found = updates([sensor], rotation=True)(belief, reading, key)
    for name in NAMES:
        after, score = found[name, 0]
        assert not score.accepted
        np.testing.assert_array_equal(after.members.values, belief.members.values)
        np.testing.assert_allclose(score.nis, 4.0)


@pytest.mark.parametrize("count", [7, 30])
def test_deterministic_noise_adds_its_covariance(count, key):
    """Exactly, with more members than dimensions; the mean stays in any case."""
    vehicle, dt = ConstantVelocity(acceleration_noise=0.5), 0.3
    rng = np.random.default_rng(count)
    members = rng.normal(size=(count, 4)) @ rng.normal(size=(4, 4))
    belief = Ensemble.of(Planar(jnp.asarray(members[:, :2]), jnp.asarray(members[:, 2:])))
    make = ft.partial(filters.make, "etkf", count=count)

    def run(belief, key):
        calm = ConstantVelocity(acceleration_noise=0.0)
        return (
            make(noise="deterministic").predict(vehicle, belief, Control(), dt, key).moments(),
            make().predict(calm, belief, Control(), dt, key).moments(),
        )

    found, calm = quick_jit(run)(belief, key)
    effect = np.kron(np.array([[dt**2 / 2], [dt]]), np.eye(2))
    growth = effect @ effect.T * 0.5**2 / dt
    np.testing.assert_allclose(found.cov - calm.cov, growth, atol=1e-12)
    jax.tree.map(ft.partial(np.testing.assert_allclose, atol=1e-12), found.mean, calm.mean)


def test_noise_that_is_not_spanned_is_drawn(key):
    """From members that are all alike, with noise about the mean: not lost, and centred."""
    vehicle = Lorenz96(size=6, process_noise=0.1)
    belief = Ensemble.of(ring(6)(jnp.ones((4000, 6))))
    filter = filters.make("denkf", count=4000, noise="deterministic")
    found = quick_jit(
        lambda key: filter.predict(
            vehicle, belief, vehicle.nominal_control(0.0), 1e-4, key
        ).moments()
    )(key)
    np.testing.assert_allclose(np.diag(found.cov), 0.1**2 * 1e-4, rtol=0.1)
    calm = vehicle.step(
        ring(6)(jnp.ones(6)), vehicle.nominal_control(0.0), ring(6)(jnp.zeros(6)), 1e-4
    )
    np.testing.assert_allclose(found.mean.values, calm.values, atol=1e-12)


@pytest.mark.slow
def test_single_precision_stays(key):
    """Nothing widens to float64, and the moments are those of float64 to rounding."""
    belief, sensor, _, reading = case(12, 8, 12)
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), (belief, reading))
    sensor32 = Components(size=12, std=jnp.float32(0.7))
    found = updates([sensor32], rotation=True, inflation=jnp.float32(1.1))(*single, key)
    double = updates([sensor], rotation=True, inflation=1.1)(belief, reading, key)
    for name in set(NAMES) - {"ensemble"}:
        after = found[name, 0][0]
        assert after.members.values.dtype == jnp.float32, name
        one, two = after.moments(), double[name, 0][0].moments()
        np.testing.assert_allclose(one.mean.values, two.mean.values, atol=2e-3, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_sample_tends_to_the_kalman_filter(name):
    """Law 12: the error of the mean falls with the root of N."""
    sensor = Components(size=4, indices=(0, 2), std=0.7)
    prior = Gaussian(ring(4)(jnp.zeros(4)), jnp.diag(jnp.array([4.0, 1.0, 2.0, 0.5])))
    reading = sensor.measures(jnp.array([1.0, -2.0]))
    exact = np.array([4 / 4.49, 0.0, -2 * 2 / 2.49, 0.0])
    counts, errors = [25, 100, 400, 1600], []
    for count in counts:
        filter = filters.make(name, count=count)

        def run(key, filter=filter):
            belief = filter.init(prior, key)
            return filter.update(sensor, belief, reading, key)[0].moments().mean.values

        found = quick_jit(jax.vmap(run))(jr.split(jr.key(1), 60))
        errors.append(np.sqrt(np.mean((np.asarray(found) - exact) ** 2)))
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert -0.6 < slope < -0.4


@pytest.mark.slow
@pytest.mark.parametrize("radius", [math.inf, 6.0])
@pytest.mark.parametrize("name", NAMES)
def test_batches_of_runs_come_back(name, radius):
    """Decompositions in batches, rotations and large states: no lock-up, nothing lost."""
    size, cycles, runs = 12, 30, 6
    vehicle = Lorenz96(size=size, process_noise=0.01)
    sensor = Components(size=size)
    rig = Rig(
        vehicle,
        (Installation("all", sensor),),
        Gaussian(vehicle.start(), jnp.eye(size)),
    )
    readings = jr.normal(jr.key(1), (runs, cycles, size))
    schedule = Schedule(
        0.05 * np.arange(1, cycles + 1), np.zeros(cycles, int), np.arange(cycles)
    )
    rows = Readings(sensor.measures(readings), np.zeros((runs, cycles), int))
    filter = filters.make(
        name, count=8, rotation=True, inflation=1.1, radius=radius, noise="deterministic"
    )
    found = estimate_runs(
        filter, rig, Log(schedule, vehicle.nominal_control(0.0), (rows,)), chunk=3
    )
    assert found.moments.mean.values.shape == (runs, cycles, size)
    assert np.isfinite(found.moments.mean.values).all()
    assert (np.asarray(found.outcome.verdict) == Verdict.FUSED).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "spec",
    [
        "ensemble:count=40,inflation=1.06",
        "etkf:count=24,inflation=1.02,rotation=true",
        "enkf-n:count=24,rotation=true,certainty=2.0",
    ],
)
def test_published_accuracy(spec):
    """On Lorenz-96 the score is the published one, which has two digits."""
    setting = load_scenario("lorenz96")
    about = setting.config.scenario
    study = Study(setting.scenario, about.burn_in, about.score, about.start, about.seed)
    found = run_study(study, {spec: build_filter(spec)}, runs=3)[spec]
    score = np.median(found.runs.time_mean_rms)
    assert score == pytest.approx(setting.config.published[spec].rmse, rel=0.08)
