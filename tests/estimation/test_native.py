"""Passes as machine code beside the same passes by XLA: the same but for rounding."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import kedge
from kedge.compiler.program import Limits
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.registry import filters, sensors
from kedge.core.verdicts import Verdict
from kedge.estimation import native
from kedge.estimation.batch import estimate_with_history
from kedge.estimation.compiled import compiled_pass
from kedge.estimation.log import REPEATED
from kedge.estimation.online import Estimator
from kedge.estimation.replay import replay
from kedge.estimation.rig import as_arrays, check_reads
from kedge.numerics.losses import Loss
from kedge.simulation.simulate import schedule, simulate, with_readings

pytest.importorskip("llvmlite")
RANDOM = {
    "auxiliary", "denkf", "enkf-n", "ensemble", "etkf", "guided", "particle", "serial-enkf",
}  # fmt: skip
LOOPS = {
    "fuzzy-noise": "scan",
    "gauss-hermite": "instructions",
    "hypotheses": "instructions",
    "posterior-linearisation": "instructions",
}
STRAIGHT = [name for name in filters.names() if name not in {"kalman", *RANDOM, *LOOPS}]


@pytest.fixture(scope="module")
def problem():
    """A rig with a map, a gate and a robust sensor, and a log with all that can be wrong."""
    vehicle = kedge.make_vehicle("unicycle")
    rig = kedge.Rig(
        vehicle,
        (
            kedge.Installation(
                "camera", kedge.make_sensor("landmarks"), robust=Loss("student")
            ),
            kedge.Installation("gnss", kedge.make_sensor("gnss"), gate=0.05, recovery=0.5),
        ),
        kedge.Gaussian(vehicle.start(), 0.1 * jnp.eye(3)),
    )
    scenario = kedge.Scenario(rig, 8.0)
    plan = schedule(scenario, output_rate=1.0)
    log = with_readings(plan.log, scenario, simulate(scenario, jr.key(0)))
    camera, gnss = log.readings
    seen = camera.measurement
    seen = seen._replace(range=seen.range.at[3].set(jnp.nan).at[9].set(jnp.inf))
    target = camera.target.at[5].set(-1).at[6].set(REPEATED)
    fix = gnss.measurement.position.at[2].set(jnp.nan).at[4].add(30.0).at[5, 1].set(jnp.nan)
    indefinite = jnp.array([[1.0, 2.0], [2.0, 1.0]])
    cov = jnp.tile(jnp.eye(2), (len(gnss.target), 1, 1)).at[6].set(indefinite)
    readings = (
        camera._replace(measurement=seen, target=target),
        gnss._replace(measurement=gnss.measurement._replace(position=fix), cov=cov),
    )
    return scenario, log._replace(readings=readings)


def assert_same(found, expected, rtol=1e-11):
    found, expected = jax.tree.leaves(found), jax.tree.leaves(expected)
    for mine, theirs in zip(found, expected, strict=True):
        mine, theirs = np.asarray(mine), np.asarray(theirs)
        assert mine.dtype == theirs.dtype
        assert mine.shape == theirs.shape
        if mine.dtype.kind != "f":
            np.testing.assert_array_equal(mine, theirs)
        else:
            np.testing.assert_allclose(mine, theirs, rtol=rtol, atol=rtol)


@pytest.mark.slow
@pytest.mark.parametrize("name", STRAIGHT)
def test_same_as_xla(name, problem):
    scenario, log = problem
    filter = kedge.make_filter(name)
    found = kedge.estimate(filter, scenario.rig, log, engine="native")
    assert_same(found, kedge.estimate(filter, scenario.rig, log, engine="xla"))
    verdicts = set(np.asarray(found.outcome.verdict).tolist())
    wanted = {Verdict.FUSED, Verdict.NOT_FINITE, Verdict.UNKNOWN_TARGET, Verdict.DUPLICATE}
    if name != "dead-reckoning":
        wanted |= {Verdict.BAD_COVARIANCE}
        if name == "fix":  # no epoch here tells enough
            wanted -= {Verdict.FUSED}
        assert wanted <= verdicts


@pytest.mark.slow
def test_same_history_and_smoother(problem):
    scenario, log = problem
    filter = kedge.make_filter("extended")
    found = estimate_with_history(filter, scenario.rig, log, engine="native")
    assert_same(found, estimate_with_history(filter, scenario.rig, log, engine="xla"))


def test_runs_are_those_of_one_log_each(problem, monkeypatch):
    """11 runs, the last register only partly used: all in one call, or four in each."""
    scenario, log = problem
    filter, keys = kedge.make_filter("extended"), jr.split(jr.key(1), 11)
    logs = jax.vmap(
        lambda key: with_readings(log, scenario, simulate(scenario, key))._replace(
            schedule=None
        )
    )(keys)._replace(schedule=log.schedule)
    whole = kedge.estimate_runs(filter, scenario.rig, logs, engine="native")
    monkeypatch.setattr(native, "MOST_BYTES", 1)
    monkeypatch.setattr(native, "cores", lambda: 1)
    parts = kedge.estimate_runs(
        filter, scenario.rig, logs, engine="native", keep=lambda e: e.moments
    )
    for mine, theirs in zip(
        jax.tree.leaves(parts), jax.tree.leaves(whole.moments), strict=True
    ):
        np.testing.assert_array_equal(mine, theirs)
    for run in (0, 10):
        own = jax.tree.map(lambda leaf, run=run: leaf[run], logs._replace(schedule=None))
        one = kedge.estimate(
            filter, scenario.rig, own._replace(schedule=log.schedule), engine="native"
        )
        assert_same(jax.tree.map(lambda leaf, run=run: leaf[run], whole), one)


def test_same_bytes_again_and_for_a_part_of_the_log(problem):
    """One program serves logs of any length."""
    scenario, log = problem
    filter = kedge.make_filter("extended")
    whole = kedge.estimate(filter, scenario.rig, log, engine="native")
    again = kedge.estimate(filter, scenario.rig, log, engine="native")
    half = len(log.schedule.time) // 2
    schedule, controls = jax.tree.map(lambda leaf: leaf[:half], (log.schedule, log.controls))
    part = log._replace(schedule=schedule, controls=controls)
    beginning = kedge.estimate(filter, scenario.rig, part, engine="native")
    for a, b, c in zip(*map(jax.tree.leaves, (whole, again, beginning)), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(np.asarray(a)[:half], c)


def test_keep_sees_what_it_asks_for(problem):
    scenario, log = problem
    filter = kedge.make_filter("extended")
    whole = kedge.estimate(filter, scenario.rig, log, engine="native")
    found = kedge.estimate(
        filter, scenario.rig, log, engine="native",
        keep=lambda e: (e.time[-1], e.moments.mean.heading, e.outcome.verdict),
    )  # fmt: skip
    assert found[0] == log.schedule.time[-1]
    np.testing.assert_array_equal(found[1], whole.moments.mean.heading)
    np.testing.assert_array_equal(found[2], whole.outcome.verdict)


@pytest.mark.parametrize("name", ["ensemble", "particle"])
def test_what_draws_is_for_xla(name, problem):
    scenario, log = problem
    with pytest.raises(ContractError, match="random"):
        kedge.estimate(kedge.make_filter(name), scenario.rig, log, engine="native")


def test_within_a_traced_program_xla_has_it(problem):
    scenario, log = problem
    filter = kedge.make_filter("extended")

    def end(shift):
        prior = scenario.rig.prior
        moved = prior.mean._replace(position=prior.mean.position + shift)
        rig = kedge.Rig(scenario.rig.vehicle, scenario.rig.sensors, prior._replace(mean=moved))
        return kedge.estimate(filter, rig, log).moments.mean.position[-1]

    assert np.isfinite(jax.jit(end)(jnp.zeros(2))).all()


def test_unknown_engine_is_refused(problem, monkeypatch):
    scenario, log = problem
    monkeypatch.setenv("KEDGE_ENGINE", "gpu")
    with pytest.raises(ContractError, match="'gpu'"):
        kedge.estimate(kedge.make_filter("extended"), scenario.rig, log)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["differential-drive", "inertial-point", "lateral-tracking", "omnidirectional"]
)
def test_same_for_other_vehicles(name):
    """With three sensors that fit them. Recorded logs and studies run the others so."""
    vehicle = kedge.make_vehicle(name)
    state = type(vehicle.start())
    size = space(vehicle.start()).size
    fitting = []
    for one in sensors.names():
        try:
            installation = kedge.Installation(one, kedge.make_sensor(one))
            check_reads(installation, state, name)
        except (ContractError, TypeError):
            continue
        fitting.append(installation)
    fitting = fitting[:3]
    rig = kedge.Rig(
        vehicle, tuple(fitting), kedge.Gaussian(vehicle.start(), 0.1 * jnp.eye(size))
    )
    scenario = kedge.Scenario(rig, 3.0)
    plan = schedule(scenario, output_rate=1.0)
    log = with_readings(plan.log, scenario, simulate(scenario, jr.key(0)))
    filter = kedge.make_filter("extended")
    found = kedge.estimate(filter, rig, log, engine="native")
    assert_same(found, kedge.estimate(filter, rig, log, engine="xla"), rtol=1e-9)


def test_online_is_the_batch_to_the_bit(problem):
    """Readings with and without their own covariance, by two programs of one memory each."""
    scenario, log = problem
    filter = kedge.make_filter("extended")
    first = jax.tree.map(lambda leaf: leaf[0], log.controls)
    for given in (
        log,
        log._replace(readings=tuple(r._replace(cov=None) for r in log.readings)),
    ):
        whole = kedge.estimate(filter, scenario.rig, given, engine="native")
        online = Estimator(filter, scenario.rig, control=first, engine="native")
        answers = list(replay(online, given))
        for field in ("position", "heading"):
            mine = np.stack([getattr(answer.moments.mean, field) for answer in answers])
            np.testing.assert_array_equal(mine, getattr(whole.moments.mean, field))
        verdicts = [int(answer.verdict) for answer in answers]
        assert verdicts == np.asarray(whole.outcome.verdict).tolist()


@pytest.mark.slow
def test_a_long_program_is_compiled_for_many_events(problem, monkeypatch):
    """What is too long for a few events is left to XLA, unless there are many of them."""
    scenario, log = problem
    rig, filter = scenario.rig, kedge.make_filter("extended")
    tree = as_arrays((filter, rig, log))
    monkeypatch.setattr(native, "SHORT", Limits(lines=10))
    with pytest.raises(ContractError, match="instructions"):
        compiled_pass(*tree, False, "native", work=native.MUCH - 1)
    assert compiled_pass(*tree, False, "native", work=native.MUCH) is not None
