"""Moments of samples against numpy and scipy."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from kedge.core.beliefs import Belief, Ensemble, Gaussian, Particles
from kedge.core.quantities import Attitude, Heading, Position
from kedge.testing import quick_jit

RANDOM = np.random.default_rng(0)


class Place(NamedTuple):
    position: Position


class Turn(NamedTuple):
    heading: Heading


class Turned(NamedTuple):
    attitude: Attitude


moments = quick_jit(lambda belief: belief.moments())


def test_an_ensemble_reports_the_sample_covariance():
    members = RANDOM.normal(size=(7, 2))
    found = moments(Ensemble.of(Place(jnp.asarray(members))))
    np.testing.assert_allclose(found.mean.position, members.mean(axis=0))
    np.testing.assert_allclose(found.cov, np.cov(members.T))


def test_particles_report_weighted_moments():
    states, weights = RANDOM.normal(size=(7, 2)), RANDOM.dirichlet(np.ones(7))
    found = moments(Particles(Place(jnp.asarray(states)), jnp.log(weights)))
    np.testing.assert_allclose(found.mean.position, np.average(states, axis=0, weights=weights))
    np.testing.assert_allclose(found.cov, np.cov(states.T, aweights=weights, ddof=0))


def test_the_mean_of_angles_across_the_seam_is_at_the_seam():
    found = moments(Ensemble.of(Turn(jnp.array([np.pi - 0.1, 0.3 - np.pi]))))
    np.testing.assert_allclose(found.mean.heading, 0.1 - np.pi)
    np.testing.assert_allclose(found.cov, [[0.4**2 / 2]])


def test_the_mean_attitude_leaves_no_turn_over():
    """Karcher's mean: the rotation vectors from it to the members sum to nothing."""
    members = Rotation.from_rotvec(0.5 * RANDOM.normal(size=(6, 3)) + [2.5, 0, 0])
    found = moments(Ensemble.of(Turned(jnp.asarray(members.as_quat()[:, [3, 0, 1, 2]]))))
    mean = Rotation.from_quat(np.asarray(found.mean.attitude)[[1, 2, 3, 0]])
    left = (mean.inv() * members).as_rotvec()
    assert np.linalg.norm(left.mean(axis=0)) < 1e-3 * np.linalg.norm(left, axis=1).mean()
    np.testing.assert_allclose(found.cov, np.cov(left.T), rtol=1e-2, atol=1e-3)


def test_a_gaussian_is_its_own_moments():
    belief = Gaussian(Place(jnp.zeros(2)), jnp.eye(2))
    assert belief.moments() is belief
    assert isinstance(belief, Belief)
