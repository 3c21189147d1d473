"""The AUV's navigation filter: honest where its model is right, without a bottom too."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy.special import chdtri

from kedge.config.scenarios import load_scenario
from kedge.core.manifolds import space_of
from kedge.estimation.rig import as_arrays
from kedge.estimation.runs import estimate_runs
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.simulation.simulate import schedule, simulate, with_readings

pytestmark = pytest.mark.slow
BEFORE, LOST, AFTER = 4, 35, 36
"""The times in s of estimates: the log is lost from 5 to 35.1 s."""


SLOW = "gyroscope_bias={std=0.002, random_walk =1e-5}, attitude_bias={std=0.005}, "
SLOW += "doppler_scale={std=0.003}"
AIDED = "thrust_scale={std=0.1}, drag_scale={std=0.1}, trim_moment={std=0.3, random_walk =0.03}"
MODELS = {
    "kinematic": (300, "body-twist", "{acceleration_noise=0.05, angular_noise=0.1}", SLOW),
    "forces": (
        100,
        "underwater",
        "{acceleration_noise=0.05, angular_noise=0.05}",
        f"{SLOW}, {AIDED}",
    ),
}
"""Runs, the vehicle, its noise, and what is estimated beside its state."""


@pytest.fixture(scope="module")
def runs(request):
    """Errors (NEES apart) and covariances: the truth moves as the filter's own model says."""
    count, model, parameters, slow = MODELS[request.param]
    changes = {
        "vehicle.model": f'"{model}"',
        "vehicle.parameters": parameters,
        "vehicle.augmented": f"{{{slow}}}",
        "scenario.duration": f"{AFTER}.0",
        "faults.lock.windows": "[[5.0, 35.1]]",
    }
    setting = load_scenario("auv-navigation", changes).scenario
    scenario = as_arrays(dataclasses.replace(setting, world=None, feedback="none"))
    plan = schedule(scenario, output_rate=1.0)
    seconds = np.round(plan.stamps[plan.outputs] / 1e9).astype(int)
    events = plan.outputs[np.searchsorted(seconds, [BEFORE, LOST, AFTER])]
    steps = np.array([BEFORE, LOST, AFTER]) * 10 - 1

    @jax.jit
    @jax.vmap
    def draw(key):
        run = simulate(scenario, key)
        log = with_readings(plan.log, scenario, run)
        return log.controls, log.readings, jax.tree.map(lambda leaf: leaf[steps], run.truth)

    controls, readings, truth = draw(jr.split(jr.key(5), count))
    log = plan.log._replace(controls=controls, readings=readings)
    found = estimate_runs(
        ExtendedKalman(),
        scenario.rig,
        log,
        keep=lambda e: jax.tree.map(lambda leaf: leaf[events], e.moments),
        chunk=100,
    )
    states = space_of(type(scenario.rig.prior.mean))
    error = jax.jit(jax.vmap(jax.vmap(states.boxminus)))(truth, found.mean)
    return np.asarray(error), np.asarray(found.cov)


@pytest.mark.parametrize("runs", MODELS, indirect=True)
@pytest.mark.parametrize("place", [0, 1, 2])
def test_nees_is_within_its_bounds(runs, place):
    """Before, at the end of, and after 30 s without a Doppler log; 99.9 % bounds."""
    error, cov = runs[0][:, place], runs[1][:, place]
    nees = np.einsum("ri,ri->r", error, np.linalg.solve(cov, error[..., None])[..., 0])
    size = error.size
    low, high = (chdtri(size, share) / len(error) for share in (0.9995, 0.0005))
    assert low < nees.mean() < high


@pytest.mark.parametrize("runs", ["kinematic"], indirect=True)
def test_position_after_an_outage_is_within_three_sigma(runs):
    """At the end of it, axis by axis, in at least 99 % of the runs.

    Not because nothing happened: in the median run the uncertainty grew tenfold. How much it
    grows in one run depends on how that vehicle turned.
    """
    error, cov = runs
    std = np.sqrt(np.diagonal(cov, axis1=2, axis2=3))[..., :3]
    inside = np.abs(error[:, 1, :3]) <= 3 * std[:, 1]
    assert (inside.mean(axis=0) >= 0.99).all()
    growth = std[:, 1, :2] / std[:, 0, :2]
    assert growth.min() > 1
    assert np.median(growth) > 10


@pytest.mark.parametrize("runs", ["kinematic"], indirect=True)
def test_nothing_jumps_when_the_bottom_is_back(runs):
    """What the first readings move the position by is what the belief before them allows."""
    error, cov = runs
    moved = error[:, 2, :3] - error[:, 1, :3]
    spread = np.sqrt(np.diagonal(cov[:, 1], axis1=1, axis2=2))[:, :3]
    assert ((np.abs(moved) <= 3 * spread).mean(axis=0) >= 0.99).all()
    left = np.sqrt(np.diagonal(cov[:, 2], axis1=1, axis2=2))[:, :3]
    assert (jnp.asarray(left[:, :2]) < spread[:, :2]).all()
