"""What sensors say, worked out by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.sensors import gnss, gnss3, landmark_camera, landmarks, velocity
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import State as Moving
from kedge.vehicles.unicycle import State as Pose

POSE = Pose(jnp.array([1.0, 2.0]), jnp.array(np.pi / 2))
MAP = landmarks.Landmark(np.array([[4.0, 6.0], [1.0, 2.0], [-2.0, 2.0]]))


def seen(sensor, state):
    return quick_jit(lambda s: (sensor.expect(s), sensor.noise_cov(s)))(state)


def test_gnss_reads_the_position():
    fix, cov = seen(gnss.Gnss(std=2.0), POSE)
    np.testing.assert_array_equal(fix.position, [1, 2])
    np.testing.assert_array_equal(cov, 4 * np.eye(2))


def test_gnss_in_space_is_worse_in_height():
    state = gnss3.Reads(jnp.array([1.0, 2.0, 3.0]))
    fix, cov = seen(gnss3.Gnss3(horizontal_std=0.5, vertical_std=3.0), state)
    np.testing.assert_array_equal(fix.position, [1, 2, 3])
    np.testing.assert_array_equal(cov, np.diag([0.25, 0.25, 9]))


def test_velocity_is_that_of_the_map_frame():
    z, cov = seen(velocity.MapVelocity(std=0.1), Moving(jnp.zeros(2), jnp.array([1.0, -2.0])))
    np.testing.assert_array_equal(z.velocity, [1, -2])
    np.testing.assert_allclose(cov, 0.01 * np.eye(2))


def test_a_landmark_is_seen_from_the_body():
    """3 east, 4 north of a vehicle that looks north: 5 m away, to the right, so negative."""
    sensor = landmarks.Landmarks(target=MAP, range_std=0.1, range_std_per_metre=0.02)
    z, cov = seen(sensor.for_target(0), POSE)
    np.testing.assert_allclose(z.range, 5)
    np.testing.assert_allclose(z.bearing, -np.arctan2(3, 4))
    np.testing.assert_allclose(cov, np.diag([(0.1 + 0.02 * 5) ** 2, 0.02**2]))


def test_a_landmark_to_the_left_has_a_positive_bearing():
    z, _ = seen(landmarks.Landmarks(target=MAP).for_target(2), POSE)
    np.testing.assert_allclose([z.range, z.bearing], [3, np.pi / 2])


def test_scale_and_bias_come_with_the_state():
    state = landmarks.Reads(*POSE, range_scale=jnp.array(1.1), bearing_bias=jnp.array(0.2))
    z, _ = seen(landmarks.Landmarks(target=MAP).for_target(2), state)
    np.testing.assert_allclose([z.range, z.bearing], [3.3, np.pi / 2 + 0.2])


def test_a_camera_gives_the_depth_along_its_axis():
    sensor = landmark_camera.LandmarkCamera(target=MAP)
    z, _ = seen(sensor.for_target(0), POSE)
    np.testing.assert_allclose([z.depth, z.bearing], [4, -np.arctan2(3, 4)], rtol=1e-12)
    state = landmark_camera.Reads(
        *POSE, depth_scale=jnp.array(0.9), bearing_bias=jnp.array(0.2)
    )
    z, _ = seen(sensor.for_target(0), state)
    # The bias is the camera's, not the world's: the depth does not turn with it.
    np.testing.assert_allclose([z.depth, z.bearing], [3.6, 0.2 - np.arctan2(3, 4)], rtol=1e-12)


@pytest.mark.parametrize("make", [landmarks.Landmarks, landmark_camera.LandmarkCamera])
def test_a_landmark_underfoot_is_seen_all_the_same(make):
    z, cov = seen(make(target=MAP).for_target(1), POSE)
    np.testing.assert_allclose(z[0], 0, atol=1e-8)
    assert np.isfinite(z.bearing)
    assert np.isfinite(cov).all()
