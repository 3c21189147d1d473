"""Smoothing of what is no plain Gaussian filter: ensembles, and filters around filters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.registry import filters
from kedge.estimation.online import Estimator
from kedge.estimation.replay import replay
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.smoother import smooth
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.gaussian.square_root import SquareRootKalman
from kedge.filters.wrappers.adaptive import Adaptive
from kedge.filters.wrappers.gated import Gated
from kedge.filters.wrappers.robust import Robust
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import ConstantVelocity


@pytest.fixture(scope="module")
def linear():
    """Ten seconds of a vehicle with constant velocity and one fix a second."""
    vehicle = ConstantVelocity(acceleration_noise=0.5)
    rig = Rig(
        vehicle,
        (Installation("gnss", Gnss(std=1.0), rate=1.0),),
        Gaussian(vehicle.start(), jnp.eye(4)),
    )
    recording, _ = record(Scenario(rig, 10.0, 0.5), jax.random.key(3), output_rate=0.1)
    return rig, jax.tree.map(np.asarray, recording.log)


@pytest.fixture(scope="module")
def exact(linear):
    return quick_jit(lambda: smooth(Kalman(), *linear)[1].moments)()


def distance(moments, exact):
    """RMS error of the means in standard deviations, and of the covariances by their size."""
    flat = [np.hstack([m.mean.position, m.mean.velocity]) for m in (moments, exact)]
    std = np.sqrt(np.diagonal(exact.cov, axis1=1, axis2=2))
    mean = np.sqrt(np.mean(((flat[0] - flat[1]) / std) ** 2))
    scale = std[:, :, None] * std[:, None, :]
    return mean, np.sqrt(np.mean(((moments.cov - exact.cov) / scale) ** 2))


@pytest.mark.parametrize("name", ["ensemble", pytest.param("etkf", marks=pytest.mark.slow)])
def test_a_large_ensemble_is_smoothed_as_the_exact_gaussian(name, linear, exact, key):
    """The error falls as one over the root of the count; a sixteenth of it, by four."""
    errors = []
    for count in (100, 1600):
        filter = filters.make(name, count=count)
        run = quick_jit(jax.vmap(lambda key, f=filter: smooth(f, *linear, key)[1].moments))
        runs = run(jax.random.split(key, 8))
        each = [
            distance(jax.tree.map(lambda leaf, i=i: leaf[i], runs), exact) for i in range(8)
        ]
        errors.append(np.sqrt(np.mean(np.square(each), axis=0)))
    assert (errors[1] < 0.05).all()
    # 8 runs of 21 correlated states know each error to some 15 %.
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.35)


def test_a_small_ensemble_stays_finite_and_semi_definite(linear, key):
    """Three members in four dimensions: their covariance has no inverse."""
    _, smoothed = quick_jit(lambda key: smooth(EnsembleKalman(count=3), *linear, key))(key)
    assert np.isfinite(smoothed.moments.cov).all()
    assert np.linalg.eigvalsh(smoothed.moments.cov).min() > -1e-12


@pytest.mark.parametrize(
    "filter",
    [
        Gated(ExtendedKalman(), 1e-12),
        Gated(ExtendedKalman(), 1e-12, recovery=5.0),
        Robust(ExtendedKalman(), "student", 1e12),
        Adaptive(ExtendedKalman(), window=1e12),
        Gated(SquareRootKalman(ExtendedKalman()), 1e-12),
    ],
    ids=["gated", "recovering", "robust", "adaptive", "square-root"],
)
def test_a_wrapper_that_changes_nothing_is_smoothed_as_what_it_wraps(filter, linear, exact):
    moments = quick_jit(lambda: smooth(filter, *linear)[1].moments)()
    for a, b in zip(jax.tree.leaves(moments), jax.tree.leaves(exact), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-10)


def test_the_window_of_an_ensemble_is_smoothed_as_the_batch(linear, key):
    rig, log = linear
    filter = EnsembleKalman(count=6)
    estimator = Estimator(
        filter, rig, key, control=jax.tree.map(lambda leaf: leaf[0], log.controls), lag=20.0
    )
    list(replay(estimator, log))
    _, expected = smooth(filter, rig, log, key)
    found = [moments for _, moments in estimator.smoothed()]
    for i, moments in enumerate(found):
        row = jax.tree.map(lambda leaf, i=i: leaf[i], expected.moments)
        for a, b in zip(jax.tree.leaves(moments), jax.tree.leaves(row), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9)
