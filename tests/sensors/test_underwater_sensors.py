"""What a vehicle under water measures, worked out by hand or with scipy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.core.errors import ContractError
from kedge.core.manifolds import space_of
from kedge.estimation.rig import Installation, Mount
from kedge.sensors import attitude, compass, doppler, usbl
from kedge.sensors.body_velocity import BodyVelocity
from kedge.sensors.depth import Depth, Reads
from kedge.sensors.gyroscope import Gyroscope
from kedge.testing import quick_jit
from kedge.vehicles.augmented import Drift, augment
from kedge.vehicles.body_twist import BodyTwist, State

# Nose to the north-east, 20 degrees up, 10 degrees over to the right.
TURN = Rotation.from_euler("ZYX", [np.pi / 4, -np.radians(20), np.radians(10)])
BODY = State(
    jnp.array([3.0, -2.0, -15.0]),
    jnp.asarray(np.roll(TURN.as_quat(), 1)),
    jnp.array([1.5, -0.1, 0.05]),
    jnp.array([0.02, -0.03, 0.2]),
)
ARM, SMALL = np.array([-0.6, 0.2, -0.1]), np.array([0.01, -0.02, 0.03])


def looks(sensor, state):
    return quick_jit(lambda s: (sensor.expect(s), sensor.noise_cov(s)))(state)


def test_doppler_swings_with_the_arm_and_turns_with_the_mount():
    mount = Mount(*ARM[:2], heading=np.pi / 4, z=ARM[2])
    seen = Installation("dvl", doppler.Doppler(), mount=mount).expect(BODY, jnp.array(0))
    swung = np.asarray(BODY.velocity_body) + np.cross(BODY.angular_rate, ARM)
    expected = Rotation.from_euler("z", -np.pi / 4).apply(swung)
    np.testing.assert_allclose(seen.velocity_body, expected, atol=1e-12)


def test_doppler_scale_misalignment_and_arm_come_with_the_state():
    state = doppler.Reads(
        BODY.velocity_body, BODY.angular_rate, jnp.array(1.02), jnp.array(SMALL), jnp.array(ARM)
    )
    z, cov = looks(doppler.Doppler(std=0.03), state)
    swung = np.asarray(BODY.velocity_body) + np.cross(BODY.angular_rate, ARM)
    expected = 1.02 * Rotation.from_rotvec(SMALL).inv().apply(swung)
    np.testing.assert_allclose(z.velocity_body, expected, atol=1e-12)
    np.testing.assert_allclose(cov, 9e-4 * np.eye(3))


def test_water_track_lacks_what_the_current_adds():
    current = np.array([0.2, -0.1, 0.0])
    state = doppler.ReadsThroughWater(
        BODY.attitude, BODY.velocity_body, BODY.angular_rate, jnp.array(current)
    )
    z, _ = looks(doppler.DopplerThroughWater(), state)
    through = np.asarray(BODY.velocity_body) - TURN.inv().apply(current)
    np.testing.assert_allclose(z.velocity_body, through, atol=1e-12)


def test_depth_is_positive_below():
    z, _ = looks(Depth(), Reads(BODY.position, jnp.array(0.3)))
    np.testing.assert_allclose(z.depth, 15.3)


def test_attitude_errs_about_the_vertical_by_heading():
    sensor = attitude.AttitudeReference(tilt_std=0.01, heading_std=0.05)
    z, cov = looks(sensor, attitude.Reads(BODY.attitude, jnp.array(SMALL)))
    expected = TURN * Rotation.from_rotvec(SMALL)
    found = Rotation.from_quat(np.roll(z.attitude, -1))
    np.testing.assert_allclose((expected.inv() * found).magnitude(), 0, atol=1e-9)
    # In the map the covariance is diagonal, however the body lies.
    matrix = TURN.as_matrix()
    expected_cov = np.diag([1e-4, 1e-4, 25e-4])
    np.testing.assert_allclose(matrix @ cov @ matrix.T, expected_cov, atol=1e-12)


def test_compass_points_where_the_nose_does():
    z, _ = looks(compass.Compass(), compass.Reads(BODY.attitude, jnp.array(0.1)))
    np.testing.assert_allclose(z.heading, np.pi / 4 + 0.1)


def test_rates_and_velocities_are_those_of_the_body():
    np.testing.assert_allclose(Gyroscope().expect(BODY).angular_rate, BODY.angular_rate)
    z = BodyVelocity().expect(BODY)
    np.testing.assert_allclose([*z.velocity_body, z.yaw_rate], [1.5, -0.1, 0.05, 0.2])


def test_usbl_hears_range_bearing_and_elevation():
    where = np.array([[23.0, -12.0, -45.0]])
    sensor = usbl.Usbl(usbl.Transponder(where), range_std=0.1, range_std_per_metre=0.01)
    seen, cov = looks(
        sensor.for_target(0), usbl.Reads(BODY.position, BODY.attitude, jnp.array(1.001))
    )
    offset = TURN.inv().apply(where[0] - np.asarray(BODY.position))
    distance = np.linalg.norm(where[0] - np.asarray(BODY.position))
    elevation = np.arcsin(offset[2] / distance)
    expected = [1.001 * distance, np.arctan2(offset[1], offset[0]), elevation]
    np.testing.assert_allclose(list(seen), expected)
    stds = [0.1 + 0.01 * distance, 0.01 / np.cos(elevation), 0.01]
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), stds)


def test_slow_quantities_of_a_navigation_filter():
    slow = dict.fromkeys(
        ["doppler_scale", "doppler_misalignment", "current", "gyroscope_bias"], Drift(0.1)
    )
    sensors = [doppler.Doppler(), doppler.DopplerThroughWater(), Gyroscope()]
    state = type(augment(BodyTwist(), slow, sensors).start())
    assert space_of(state).size == 12 + 1 + 3 + 3 + 3
    with pytest.raises(ContractError, match="'doppler_arms' is neither a parameter"):
        augment(BodyTwist(), {"doppler_arms": Drift()}, sensors)
