"""The driver over runs: the same figures by either compiler, whatever stands beside them."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import kedge
from kedge import filters, sensors, vehicles
from kedge.estimation.rig import as_arrays
from kedge.estimation.runner import Runner, parts

COUNT = 5


@pytest.fixture(scope="module")
def given():
    """A filter, its rig, and three seconds of five runs."""
    vehicle = vehicles.ConstantVelocity()
    prior = kedge.Gaussian(vehicle.start(), jnp.eye(4))
    rig = kedge.Rig(vehicle, (kedge.Installation("gnss", sensors.Gnss(), rate=1.0),), prior)
    recording, _ = kedge.record(kedge.Scenario(rig, 3.0, 0.5), jr.key(1), output_rate=1.0)
    noise = np.random.default_rng(2).normal(size=(COUNT, 1, 1))
    log = recording.log._replace(
        controls=jax.tree.map(lambda leaf: np.stack([leaf] * COUNT), recording.log.controls),
        readings=jax.tree.map(
            lambda leaf: (
                np.asarray(leaf) + noise if leaf.dtype == float else np.stack([leaf] * COUNT)
            ),
            recording.log.readings,
        ),
    )
    return as_arrays((filters.Kalman(), rig, log))


def flags(given):
    common, per_run = (jax.tree.map(lambda _, f=f: f, given) for f in (False, True))
    return *common[:2], per_run[2]._replace(schedule=common[2].schedule)


@pytest.mark.parametrize("engine", ["native", "xla"])
def test_runs_are_those_of_one_log_each(given, engine):
    """Two runs at once: the third part is filled up with a run that is dropped."""
    if engine == "native":
        pytest.importorskip("llvmlite")

    def keep(estimates):
        return estimates.moments.mean.position, estimates.time[-1]

    runner = Runner(given, keep=keep, per_run=flags(given), engine=engine, at_once=2)
    assert runner.compiler == engine
    runner.compile(given, np.arange(COUNT))
    spent = runner.compile_seconds
    assert runner.is_ready
    assert spent > 0
    position, end = runner.over_runs(given, np.arange(COUNT))
    assert runner.compile_seconds == spent
    assert position.shape[0] == COUNT
    np.testing.assert_array_equal(end, np.full(COUNT, given[2].schedule.time[-1]))
    filter, rig, log = given
    for run in (0, COUNT - 1):
        own = jax.tree.map(lambda leaf, run=run: leaf[run], log._replace(schedule=()))
        alone = kedge.estimate(filter, rig, own._replace(schedule=log.schedule), engine="xla")
        np.testing.assert_allclose(position[run], alone.moments.mean.position, rtol=1e-12)


@pytest.mark.parametrize(("runs", "most"), [(1, 8), (8, 8), (9, 8), (1000, 62)])
def test_parts_are_of_one_size_and_hold_every_run_in_order(runs, most):
    rows = parts(runs, most)
    assert len({len(part) for part in rows}) == 1
    assert len(rows[0]) <= most
    np.testing.assert_array_equal(np.concatenate(rows)[:runs], np.arange(runs))
    assert all(row == runs - 1 for row in np.concatenate(rows)[runs:])
