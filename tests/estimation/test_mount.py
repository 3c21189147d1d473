"""Where a mount in space puts a sensor, against matrices and against a finite difference."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Turn

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.manifolds import charts_of
from kedge.core.quantities import AngularRate3, Attitude, Position3, Velocity3
from kedge.core.registry import sensors, vehicles
from kedge.estimation.mount import seen_from, validation_error
from kedge.estimation.rig import Installation, Mount, Rig
from kedge.testing import quick_jit

MOUNT = Mount(0.8, -0.3, heading=2.0, z=0.4, roll=0.3, pitch=-0.5)


seen = quick_jit(lambda body: seen_from(MOUNT, body))


class Body(NamedTuple):
    position: Position3
    attitude: Attitude
    velocity: Velocity3
    velocity_body: Velocity3
    angular_rate: AngularRate3


def turn(quaternion):
    return Turn.from_quat(np.roll(np.asarray(quaternion), -1))


def body_at(time):
    """A body that turns at a constant rate of its own and moves on a straight line."""
    rate = np.array([0.3, -0.7, 1.1])
    position = np.array([1.0, 2.0, 3.0]) + time * np.array([4.0, -1.0, 0.5])
    attitude = Turn.from_euler("ZYX", [0.4, 0.2, -1.0]) * Turn.from_rotvec(rate * time)
    velocity = np.array([4.0, -1.0, 0.5])
    quaternion = np.roll(attitude.as_quat(), 1)
    return Body(
        *map(
            jnp.asarray, (position, quaternion, velocity, attitude.inv().apply(velocity), rate)
        )
    )


def test_a_mount_in_space_composes_rotations():
    body = body_at(0.0)
    there = seen(body)
    sensor = Turn.from_euler("ZYX", [MOUNT.heading, MOUNT.pitch, MOUNT.roll])
    expected = turn(body.attitude) * sensor
    np.testing.assert_allclose(
        (turn(there.attitude).inv() * expected).magnitude(), 0, atol=1e-12
    )
    np.testing.assert_allclose(
        there.position, body.position + turn(body.attitude).apply([0.8, -0.3, 0.4]), rtol=1e-12
    )


def test_the_velocity_of_a_mounted_sensor_is_the_derivative_of_its_place():
    step = 1e-5
    before, here, after = (seen(body_at(t)) for t in (-step, 0.0, step))
    velocity = (after.position - before.position) / (2 * step)
    np.testing.assert_allclose(here.velocity, velocity, atol=1e-8)
    inside = turn(here.attitude).inv()
    np.testing.assert_allclose(here.velocity_body, inside.apply(np.array(velocity)), atol=1e-8)
    turned = (turn(before.attitude).inv() * turn(after.attitude)).as_rotvec() / (2 * step)
    np.testing.assert_allclose(here.angular_rate, turned, atol=1e-8)


def test_a_velocity_at_the_end_of_an_arm_needs_the_angular_rate():
    has = charts_of(type(vehicles.make("strapdown").start()))
    assert "angular_rate in the state" in str(validation_error(MOUNT, has, {"velocity"}))
    assert validation_error(MOUNT._replace(x=0.0, y=0.0, z=0.0), has, {"velocity"}) is None
    assert validation_error(MOUNT, has, {"position"}) is None


@pytest.mark.parametrize("name", ["z", "roll", "pitch"])
def test_in_the_plane_a_mount_has_no_height_and_no_tilt(name):
    vehicle = vehicles.make("unicycle")
    mounted = Installation("gnss", sensors.make("gnss"), mount=Mount(**{name: 0.1}))
    with pytest.raises(
        ContractError, match=f"'gnss' has a mount with {name} = 0.1, but Unicycle"
    ):
        Rig(vehicle, (mounted,), Gaussian(vehicle.start(), jnp.eye(3)))
