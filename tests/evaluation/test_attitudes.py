"""Heading, pitch and roll against scipy, and their spread against a cloud of attitudes."""

import numpy as np
from scipy.spatial.transform import Rotation

from kedge.evaluation.attitudes import angles_of


def quaternions(turns):
    return turns.as_quat()[:, [3, 0, 1, 2]]


def test_angles_are_those_of_successive_turns():
    rng = np.random.default_rng(0)
    heading, pitch, roll = rng.uniform(-1, 1, (3, 50)) * np.array([[3.1], [1.5], [3.1]])
    # With the nose up is a negative turn about the axis to the left.
    turns = Rotation.from_euler("ZYX", np.stack([heading, -pitch, roll], axis=1))

    found = angles_of(quaternions(turns))

    np.testing.assert_allclose(found[:3], [heading, pitch, roll], atol=1e-9)


def test_spread_is_that_of_a_cloud():
    rng = np.random.default_rng(1)
    root = 0.002 * rng.normal(size=(3, 3))
    turn = Rotation.from_euler("ZYX", [[0.7, -0.9, 0.4]])
    cloud = turn * Rotation.from_rotvec(rng.normal(size=(200_000, 3)) @ root.T)

    found = angles_of(quaternions(turn), (root @ root.T)[None])
    spread = np.std(angles_of(quaternions(cloud))[:3], axis=1)

    np.testing.assert_allclose(found.std[:, 0], spread, rtol=0.01)
