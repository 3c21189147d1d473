"""On data drawn from its own model a filter is as sure as it may be (law 14).

Every run has its own truth, process noise and readings. Sums over independent runs are
chi-square; their bounds hold 99.9 % of such tests, so that a failure means something, and are
narrow enough for 200 runs to find a covariance that is wrong by a quarter.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space
from kedge.core.registry import filters, sensors, vehicles
from kedge.core.verdicts import Verdict
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.smoother import smooth
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import schedule, simulate, with_readings
from kedge.testing import quick_jit

RUNS = 200
CASES = {
    "linear": ("constant-velocity", "gnss", "velocity"),
    "robot": ("unicycle", "gnss", "landmarks"),
}


def mean_within(total, dof):
    """The mean of chi-squares with ``dof`` degrees of freedom in all, and its bounds."""
    return scipy.stats.chi2(dof).ppf(0.0005) <= total <= scipy.stats.chi2(dof).ppf(0.9995)


class Scores(NamedTuple):
    filtered: np.ndarray  # NEES of run and event
    smoothed: np.ndarray
    nis: np.ndarray
    dof: np.ndarray
    verdict: np.ndarray
    larger: np.ndarray  # smallest eigenvalue of filtered minus smoothed covariance
    size: int


def scores(case, name, factor=1.0):
    """Run a filter whose process noise is off by ``factor`` over matched data."""
    vehicle, *carried = CASES[case]
    model = vehicles.make(vehicle)
    states = space(model.start())
    installed = tuple(Installation(one, sensors.make(one), rate=2.0) for one in carried)
    prior = Gaussian(model.start(), 0.04 * jnp.eye(states.size))
    scenario = Scenario(Rig(model, installed, prior), duration=6.0, dt=0.1)
    plan = schedule(scenario, output_rate=1.0)
    noisy = jax.tree.map(lambda leaf: leaf * factor**0.5, model) if factor != 1 else model
    # The truth stands at the ends of the simulation's steps.
    step = np.round(np.asarray(plan.log.schedule.time) / scenario.dt).astype(int) - 1
    after = step >= 0

    @quick_jit
    @jax.vmap
    def one(key):
        run = simulate(scenario, key)
        log = with_readings(plan.log, scenario, run)
        rig = Rig(noisy, installed, prior)
        filtered, smoothed = smooth(filters.make(name), rig, log)
        truth = jax.tree.map(lambda leaf: leaf[step], run.truth)

        def errors(moments):
            return jax.vmap(states.boxminus)(truth, moments.mean), moments.cov

        outcome = filtered.outcome
        scored = outcome.nis, outcome.dof, outcome.verdict
        return errors(filtered.moments), errors(smoothed.moments), scored

    found = jax.tree.map(
        lambda leaf: np.asarray(leaf)[:, after], one(jr.split(jr.key(7), RUNS))
    )
    # Decompositions in numpy: several batched ones in one program can hang jaxlib 0.10.
    filtered, smoothed, scored = found
    gain = np.linalg.eigvalsh(filtered[1] - smoothed[1])[..., 0]
    return Scores(nees(*filtered), nees(*smoothed), *scored, gain, states.size)


def nees(error, cov):
    return np.einsum("rki,rki->rk", error, np.linalg.solve(cov, error[..., None])[..., 0])


@pytest.fixture(
    scope="module",
    params=[
        ("robot", "extended"),
        pytest.param(("linear", "kalman"), marks=pytest.mark.slow),
        pytest.param(("linear", "unscented"), marks=pytest.mark.slow),
        pytest.param(("robot", "unscented"), marks=pytest.mark.slow),
    ],
    ids="-".join,
)
def run(request):
    return scores(*request.param)


@pytest.mark.parametrize("share", [0.3, 0.6, 1.0])
def test_the_covariance_is_that_of_the_errors(run, share):
    """NEES at three moments; one run's errors hang together, so moments are judged apart."""
    place = int(share * (run.filtered.shape[1] - 1))
    assert mean_within(run.filtered[:, place].sum(), RUNS * run.size)
    assert mean_within(run.smoothed[:, place].sum(), RUNS * run.size)


def test_the_innovations_are_those_expected(run):
    """NIS of all readings: innovations are independent of each other."""
    fused = run.verdict == Verdict.FUSED
    assert (fused == (run.verdict != Verdict.NONE)).all()
    assert mean_within(run.nis[fused].sum(), run.dof[fused].sum())


def test_smoothing_never_adds_doubt(run):
    """And nothing at the end, where no later reading says more."""
    assert run.larger.min() > -1e-10
    np.testing.assert_array_equal(run.larger[:, -1], 0)
    np.testing.assert_array_equal(run.filtered[:, -1], run.smoothed[:, -1])


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_noise_is_found_out(factor):
    """So the bounds are no formality."""
    found = scores("linear", "kalman", factor)
    fused = found.verdict == Verdict.FUSED
    inside = mean_within(found.filtered[:, -1].sum(), RUNS * found.size)
    assert not (inside and mean_within(found.nis[fused].sum(), found.dof[fused].sum()))
