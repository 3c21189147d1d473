"""What a rig refuses, and where a mount puts a sensor."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.registry import sensors, vehicles
from kedge.estimation.rig import Installation, Mount, Rig, as_arrays
from kedge.sensors.landmarks import Landmark, Landmarks
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import State, Unicycle

PRIOR = Gaussian(Unicycle().start(), jnp.eye(3))


def rig(vehicle="unicycle", prior=PRIOR, **installed):
    fitted = (Installation(name, sensors.make(sensor)) for name, sensor in installed.items())
    return Rig(vehicles.make(vehicle), tuple(fitted), prior)


def test_a_sensor_that_reads_what_the_state_has_not_is_refused():
    with pytest.raises(ContractError) as error:
        rig(dvl="velocity")
    for part in (
        "MapVelocity ('dvl') reads",
        "velocity",
        "the state of Unicycle is",
        "heading",
    ):
        assert part in str(error.value)


def test_a_field_of_another_kind_is_refused():
    with pytest.raises(ContractError, match=r"Gnss3 .*shape=\(3,\).*Unicycle.*shape=\(2,\)"):
        rig(gnss="gnss3")


def test_two_sensors_of_one_kind_are_told_apart_by_name():
    both = rig(bow="gnss", stern="gnss")
    assert (both.index("bow"), both.index("stern")) == (0, 1)
    with pytest.raises(ContractError, match=r"no sensor 'mast'.*'bow', 'stern'"):
        both.index("mast")


def test_sensors_may_be_a_list():
    installed = [Installation("gnss", sensors.make("gnss"))]
    assert Rig(vehicles.make("unicycle"), installed, PRIOR).sensors == tuple(installed)


def test_one_name_for_two_sensors_is_refused():
    twins = (Installation("bow", sensors.make("gnss")), Installation("bow", Landmarks()))
    with pytest.raises(ContractError, match="two sensors are called 'bow'"):
        Rig(Unicycle(), twins, PRIOR)


class Other(NamedTuple):
    position: jax.Array
    heading: jax.Array


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        (
            Gaussian(Other(*PRIOR.mean), PRIOR.cov),
            r"prior's mean is a Other.*Unicycle is a State",
        ),
        (Gaussian(PRIOR.mean, jnp.eye(4)), r"shape \(4, 4\).*'heading'\) needs \(3, 3\)"),
    ],
)
def test_a_prior_that_does_not_fit_is_refused(prior, message):
    with pytest.raises(ContractError, match=message):
        rig(prior=prior)


def test_a_mount_needs_a_pose():
    mounted = Installation("gnss", sensors.make("gnss"), mount=Mount(1.0, 0.0, 0.0))
    vehicle = vehicles.make("constant-velocity")
    with pytest.raises(ContractError, match="has a mount, which needs position and heading"):
        Rig(vehicle, (mounted,), Gaussian(vehicle.start(), jnp.eye(4)))


@pytest.mark.parametrize("latency", [float("nan"), float("inf")])
def test_a_latency_is_a_number(latency):
    with pytest.raises(ContractError, match=r"sensor 'gnss': latency is (nan|inf), not finite"):
        Installation("gnss", sensors.make("gnss"), latency=latency)


def planar(x, y, heading):
    cos, sin = np.cos(heading), np.sin(heading)
    return np.array([[cos, -sin, x], [sin, cos, y], [0, 0, 1]])


def test_a_mounted_sensor_sees_from_where_it_sits():
    """Homogeneous matrices: the landmark in the sensor's frame, map <- body <- sensor."""
    lever, landmark = (0.8, -0.3, 2.0), np.array([3.0, -1.0])
    sensor = Landmarks(target=Landmark(landmark[None]))
    mounted = Installation("camera", sensor, mount=Mount(*lever))
    look = quick_jit(
        lambda x, y, h: mounted.expect(State(jnp.stack([x, y]), h), jnp.asarray(0))
    )
    random = np.random.default_rng(0)
    for pose in random.uniform(-3, 3, (10, 3)):
        seen = look(*pose)
        x, y, _ = np.linalg.inv(planar(*pose) @ planar(*lever)) @ [*landmark, 1]
        np.testing.assert_allclose(seen.range, np.hypot(x, y), rtol=1e-12)
        np.testing.assert_allclose(np.exp(1j * seen.bearing), np.exp(1j * np.arctan2(y, x)))


def test_a_mounted_sensor_is_that_of_a_vehicle_displaced():
    mount, pose = Mount(0.8, -0.3, 2.0), (1.0, 2.0, 2.5)
    displaced = planar(*pose) @ planar(*mount[:3])
    state = State(jnp.array(pose[:2]), jnp.array(pose[2]))
    moved = State(jnp.asarray(displaced[:2, 2]), jnp.array(pose[2] + mount.heading))
    sensor = Landmarks(range_std_per_metre=0.1)

    @quick_jit
    def both(one, other):
        target = jnp.asarray(1)
        plain, mounted = (Installation("a", sensor), Installation("b", sensor, mount=mount))
        return (
            (mounted.expect(one, target), mounted.noise_cov(one, target)),
            (plain.expect(other, target), plain.noise_cov(other, target)),
        )

    for one, other in zip(*map(jax.tree.leaves, both(state, moved)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_a_map_knows_its_own_targets():
    mapped, plain = Installation("a", Landmarks()), Installation("b", sensors.make("gnss"))
    assert (mapped.targets, plain.targets) == (3, None)
    found = [bool(mapped.knows(jnp.asarray(i))) for i in (-1, 0, 2, 3, 99)]
    assert found == [False, True, True, False, False]
    assert [bool(plain.knows(jnp.asarray(i))) for i in (-1, 0)] == [False, True]


def test_parameters_become_arrays_of_one_type():
    """A number, a weakly typed array and a strong one are the same program's input."""
    weak = jnp.asarray(2.0) * 1
    for value in (2.0, weak, np.float64(2.0), jnp.array(2.0)):
        leaf = as_arrays({"std": value})["std"]
        assert (leaf.dtype, leaf.weak_type) == (jnp.float64, False)
    assert as_arrays(3).dtype == jnp.int64
    assert as_arrays(np.arange(3)).dtype == jnp.int64


def test_a_rig_may_be_made_while_a_program_is_traced():
    """Studies do so for a filter with a vehicle of its own: all that is computed is traced."""
    cov = jax.eval_shape(lambda: rig(gnss="gnss", camera="landmarks").prior.cov)
    assert cov.shape == (3, 3)
