"""The scan over a log: same bytes, one program, real branches."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError, DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import estimate, estimate_with_history, pass_over
from kedge.estimation.log import Log, Schedule
from kedge.estimation.rig import Installation, Mount, Rig, as_arrays
from kedge.estimation.runs import estimate_runs
from kedge.estimation.step import prediction_key, reading_key
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.filters.wrappers.gated import Gated
from kedge.sensors.gnss import Gnss
from kedge.sensors.landmarks import Landmarks
from kedge.testing import quick_jit
from kedge.vehicles.benchmarks.lorenz96 import Lorenz96
from kedge.vehicles.unicycle import Unicycle


def contents(tree):
    return b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree))


def test_the_same_log_gives_the_same_bytes(rig, log, key):
    filter = EnsembleKalman(count=5)
    run = quick_jit(
        lambda readings, key: estimate(filter, rig, log._replace(readings=readings), key)
    )
    once, again, other = (contents(run(log.readings, k)) for k in (key, key, jr.key(99)))
    assert once == again
    assert once != other, "it does draw"


PROGRAM = """
import hashlib, jax, numpy as np
from kedge import Gaussian, Installation, Rig, Scenario, estimate, make_filter, make_sensor
from kedge import make_vehicle, record
vehicle = make_vehicle("unicycle")
sensors = tuple(Installation(name, make_sensor(name)) for name in ("gnss", "landmarks"))
rig = Rig(vehicle, sensors, Gaussian(vehicle.start(), 0.1 * np.eye(3)))
recording, _ = record(Scenario(rig, duration=5.0), jax.random.key(1))
found = estimate(make_filter("ensemble", count=10), rig, recording.log)
parts = [np.asarray(x).tobytes() for x in jax.tree.leaves(found)]
print(hashlib.sha256(b"".join(parts)).hexdigest())
"""


@pytest.mark.slow
def test_another_process_gives_the_same_bytes():
    """Nothing depends on the order of hashes, nor on what ran before."""
    digests = set()
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        digests.add(done.stdout)
    assert len(digests) == 1


TRACED = []


class Counted(Unicycle):
    """A unicycle that counts how often it is traced."""

    def step(self, state, control, noise, dt):
        TRACED.append(state)
        return super().step(state, control, noise, dt)


def test_a_changed_number_compiles_nothing(log):
    """A sweep over noise, geometry, prior or readings is one program."""

    def run(speed_noise, std, lever, spread, shift):
        mount = Mount(lever, 0.0, 0.0)
        sensors = (
            Installation("gnss", Gnss(std=std), mount=mount),
            Installation("camera", Landmarks(range_std=std)),
        )
        vehicle = Counted(speed_noise=speed_noise)
        rig = Rig(vehicle, sensors, Gaussian(vehicle.start(), spread * np.eye(3)))
        moved = jax.tree.map(lambda leaf: leaf + shift, log.readings[0].measurement)
        readings = (log.readings[0]._replace(measurement=moved), log.readings[1])
        return estimate(ExtendedKalman(), rig, log._replace(readings=readings)).moments

    first = run(0.1, 1.0, 0.0, 0.1, 0.0)
    count = len(TRACED)
    assert count > 0
    varied = [
        run(0.2, 1.0, 0.0, 0.1, 0.0),
        run(0.1, 1.5, 0.0, 0.1, 0.0),
        run(0.1, 1.0, 0.4, 0.1, 0.0),
        run(0.1, 1.0, 0.0, 0.3, 0.0),
        run(0.1, 1.0, 0.0, 0.1, 0.5),
    ]
    assert len(TRACED) == count
    # All of them matter.
    assert len({contents(first), *map(contents, varied)}) == 6


def runs_of(log, count):
    """Readings of some runs that share a schedule."""
    random = np.random.default_rng(0)

    def shaken(leaf):
        shift = 0.1 * random.normal(size=(count, *leaf.shape))
        return leaf[None] + (shift if leaf.dtype == float else 0 * shift.astype(int))

    return jax.tree.map(shaken, log.readings)


@pytest.fixture(scope="module")
def batched(rig, log):
    """Runs in a batch, with a shared schedule; and the program."""
    filter, model = as_arrays((ExtendedKalman(), rig))

    def one(schedule, readings):
        given = log._replace(schedule=schedule, readings=readings)
        return pass_over(filter, model, given, jr.key(0), False)[0]

    def compiled(axis, schedule, readings):
        options = {"xla_backend_optimization_level": 0}
        program = jax.jit(jax.vmap(one, (axis, 0)), compiler_options=options)
        return program.lower(schedule, readings).compile()

    readings = runs_of(log, 4)
    shared = compiled(None, log.schedule, readings)
    return compiled, readings, shared, shared(log.schedule, readings)


def conditionals(program):
    return program.as_text().count(" conditional(")


def test_a_shared_schedule_keeps_its_branches(log, batched):
    """The predict and the choice of the sensor; a batched schedule would run every branch."""
    compiled, readings, shared, _ = batched
    copies = jax.tree.map(lambda leaf: np.stack([leaf] * 4), log.schedule)
    # What is left is the recovery of a gate, which branches for the batch as a whole.
    assert conditionals(shared) - conditionals(compiled(0, copies, readings)) >= 2


def test_runs_in_a_batch_are_the_runs_alone(extended, batched):
    _, readings, _, found = batched
    for i in range(4):
        alone = extended(readings=jax.tree.map(lambda leaf, i=i: leaf[i], readings))
        for a, b in zip(*map(jax.tree.leaves, (alone, found)), strict=True):
            np.testing.assert_allclose(a, b[i] if np.ndim(b) > np.ndim(a) else b, rtol=1e-9)


@pytest.mark.slow
def test_the_chunk_changes_no_draw(rig, log, key):
    """Runs are the same, whatever they are run beside."""
    filter = EnsembleKalman(count=5)
    many = log._replace(
        controls=jax.tree.map(lambda leaf: np.stack([leaf] * 3), log.controls),
        readings=runs_of(log, 3),
    )
    means = [
        estimate_runs(filter, rig, many, key, lambda e: e.moments.cov, chunk)
        for chunk in (1, 3)
    ]
    np.testing.assert_allclose(means[0], means[1], rtol=1e-9)
    alone = estimate(
        filter,
        rig,
        jax.tree.map(lambda leaf: leaf[2], many._replace(schedule=()))._replace(
            schedule=log.schedule
        ),
        jr.fold_in(key, 2),
    )
    np.testing.assert_allclose(alone.moments.cov, means[0][2], rtol=1e-9)


@pytest.mark.parametrize("count", [0, 3])
def test_runs_are_equally_many_everywhere(rig, log, count):
    controls = jax.tree.map(lambda leaf: np.stack([leaf] * 2), log.controls)
    readings = jax.tree.map(
        lambda leaf: np.zeros((count, *leaf.shape), leaf.dtype), log.readings
    )
    with pytest.raises(DataError, match=rf"runs: found \[{min(2, count)}, {max(2, count)}\]"):
        estimate_runs(ExtendedKalman(), rig, log._replace(controls=controls, readings=readings))


def test_an_event_out_of_order_is_late_and_changes_nothing(log, extended):
    """navlie's guard fuses such a reading as if it were current."""
    schedule = log.schedule
    place = int(np.flatnonzero(schedule.sensor == 0)[2])
    before = schedule.time.copy()
    before[place] -= 1.0
    late = extended(schedule._replace(time=before))
    # The same events, but for that reading.
    silent, at = schedule.sensor.copy(), schedule.time.copy()
    silent[place], at[place] = -1, at[place - 1]
    missing = extended(schedule._replace(sensor=silent, time=at))
    assert int(late.outcome.verdict[place]) == Verdict.LATE
    assert (np.delete(late.outcome.verdict, place) != Verdict.LATE).all()
    assert contents(late.moments) == contents(missing.moments)


def test_a_reading_without_a_step_changes_the_moments_of_a_cloud(rig, log, key):
    """Moments of clouds are computed only where an event has changed something."""
    schedule = log.schedule
    some = np.flatnonzero(np.asarray(schedule.sensor) >= 0)[[0, 0, 0]]
    again = Schedule(
        jnp.full(3, schedule.time[some[0]]),
        np.array([schedule.sensor[some[0]], -1, schedule.sensor[some[0]]]),
        schedule.row[some],
    )
    controls = jax.tree.map(lambda leaf: leaf[some], log.controls)
    found = estimate(EnsembleKalman(count=5), rig, Log(again, controls, log.readings), key)
    first, nothing, last = np.asarray(found.moments.cov)
    np.testing.assert_array_equal(nothing, first)
    assert found.outcome.verdict[2] == Verdict.FUSED
    assert np.trace(last) < np.trace(first)


def test_a_sensor_that_never_fires(rig, log, extended):
    """A part of a log may hold no reading of one of the sensors."""
    none = jax.tree.map(lambda leaf: leaf[:0], log.readings[1])
    sensor = np.where(log.schedule.sensor == 1, -1, log.schedule.sensor)
    schedule = log.schedule._replace(sensor=sensor)
    run = quick_jit(lambda log: estimate(ExtendedKalman(), rig, log))
    found = run(log._replace(schedule=schedule, readings=(log.readings[0], none)))
    expected = extended(schedule)
    np.testing.assert_allclose(found.moments.cov, expected.moments.cov, rtol=1e-12)


def test_particles_cannot_be_smoothed(rig, log):
    for filter in (BootstrapParticle(count=5), Gated(BootstrapParticle(count=5))):
        with pytest.raises(ContractError, match="BootstrapParticle cannot be smoothed"):
            estimate_with_history(filter, rig, log)


def test_history_changes_no_estimate(rig, log, extended):
    run = quick_jit(lambda log: estimate_with_history(ExtendedKalman(), rig, log)[0].moments)
    for a, b in zip(*map(jax.tree.leaves, (run(log), extended().moments)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


def test_what_is_not_kept_is_not_stored(key):
    """A thousand states: 8 MB a covariance, 1.6 GB for the log; the means are 2 MB."""
    vehicle, steps = Lorenz96(size=1000), 200
    rig = Rig(vehicle, (), Gaussian(vehicle.start(), 1e-6 * jnp.eye(1000)))
    log = Log(
        Schedule(0.01 * (1 + jnp.arange(steps)), jnp.full(steps, -1), jnp.zeros(steps, int)),
        jax.tree.map(
            lambda leaf: jnp.zeros((steps, *jnp.shape(leaf))), vehicle.nominal_control(0.0)
        ),
        (),
    )
    filter = EnsembleKalman(count=5)

    def means(key):
        return estimate(filter, rig, log, key, keep=lambda found: found.moments.mean)

    compiled = jax.jit(means).lower(key).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < 50e6
    assert jax.tree.leaves(compiled(key))[0].shape == (steps, 1000)


def test_no_key_is_used_twice():
    """Neither for two predictions, two readings, or one of each."""
    numbers = range(1, 6)
    made = [kind(jr.key(0), i) for i in numbers for kind in (prediction_key, reading_key)]
    keys = [jr.key(0), *made]
    data = {tuple(np.asarray(jr.key_data(key)).tolist()) for key in keys}
    assert len(data) == len(keys) == 11
