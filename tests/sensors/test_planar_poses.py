"""Heading, pose and increment of a vehicle in the plane, against what they say of a motion."""

import jax
import jax.numpy as jnp
import numpy as np

from kedge.sensors.heading import PlanarHeading
from kedge.sensors.odometry_increment import OdometryIncrement
from kedge.sensors.pose import PlanarPose
from kedge.vehicles.coasting_body import CoastingBody
from kedge.vehicles.unicycle import State

POSE = State(jnp.array([3.0, -1.0]), jnp.asarray(3.0))


def test_a_heading_is_off_by_its_bias_and_wraps():
    seen = PlanarHeading().observe(PlanarHeading.reads(POSE.heading, 0.5))
    np.testing.assert_allclose(seen.heading, 3.5 - 2 * np.pi)


def test_a_pose_is_the_state():
    seen = PlanarPose().expect(POSE)
    np.testing.assert_array_equal(seen.position, POSE.position)
    assert seen.heading == POSE.heading
    np.testing.assert_allclose(
        PlanarPose(position_std=0.1, heading_std=0.2).noise_cov(POSE),
        np.diag([0.01, 0.01, 0.04]),
    )


def test_an_increment_is_the_pose_seen_from_the_pose_before():
    """For a body that drifts sideways while it turns, as it really moved."""
    body, interval = CoastingBody(), 0.7
    before = body.start()._replace(heading=jnp.asarray(2.5))
    calm = jax.tree.map(jnp.zeros_like, body.noise_density())
    after = body.step(before, body.nominal_control(0.0), calm, interval)
    way = np.asarray(after.position - before.position) @ [1, 1j]
    seen = OdometryIncrement(interval=interval).expect(after)
    np.testing.assert_allclose(seen.offset @ jnp.array([1, 1j]), way * np.exp(-2.5j))
    np.testing.assert_allclose(seen.turn, after.heading - before.heading)
