"""Ranges to anchors, worked out by hand, and what of them is estimated."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.config.scenarios import load_scenario
from kedge.core.beliefs import Gaussian
from kedge.core.errors import ConfigError, ContractError
from kedge.core.verdicts import Verdict
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Installation, Mount, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.ranges import Anchor, Measurement, Ranges, Ranges3, Reads3
from kedge.testing import check_sensor, quick_jit
from kedge.vehicles.augmented import Drift, augment
from kedge.vehicles.unicycle import State as Pose
from kedge.vehicles.unicycle import Unicycle

PLACES = np.array([[3.0, 4.0], [0.0, 0.0]])
POSE = Pose(jnp.zeros(2), jnp.array(np.pi / 2))

SCENARIO = """
[scenario]
title = "a yard"
source = "these tests"
duration = 1.0
filters = ["extended"]
[vehicle]
model = "unicycle"
augmented = { anchor_bias = { std = 0.3 }, range_scale = { std = 0.1 } }
[sensors.radio]
model = "ranges"
map = "anchors"
parameters = { biases = "anchor_bias", tag_height = 0.3 }
[maps.anchors]
ids = ["a", "b", "c"]
columns = { position_x = [0, 30, 0], position_y = [0, 0, 20], offset = [0.1, 0.2, 0.3] }
[prior]
std = { position = 1, heading = 0.1 }
"""


def seen(sensor, state, index=0):
    return quick_jit(
        lambda s: (sensor.for_target(index).expect(s), sensor.for_target(index).noise_cov(s))
    )(state)


def test_a_range_is_the_distance_in_space():
    """3 east, 4 north and 12 above the tag: 13 m."""
    anchors = Anchor(PLACES, position_z=np.array([12.5, 0.5]))
    range_, cov = seen(Ranges(target=anchors, range_std=0.2, tag_height=0.5), POSE)
    np.testing.assert_allclose(range_.range, 13)
    np.testing.assert_allclose(cov, [[0.04]])


def test_what_is_known_of_each_anchor_comes_from_the_map():
    anchors = Anchor(PLACES, offset=np.array([0.25, 0]), scale=1.1, std=np.array([0.0, 0.5]))
    sensor = Ranges(target=anchors, range_std=0.1, range_std_per_metre=0.02)
    range_, cov = seen(sensor, POSE)
    np.testing.assert_allclose(range_.range, 1.1 * 5 + 0.25)
    np.testing.assert_allclose(cov, [[(0.1 + 0.02 * 5) ** 2]])
    np.testing.assert_allclose(seen(sensor, POSE, 1)[1], [[0.25]])


def test_in_space_the_height_is_part_of_the_state():
    state = Reads3(jnp.array([1.0, 2.0, 3.0]), range_scale=jnp.array(2.0))
    range_, _ = seen(Ranges3(target=Anchor(np.array([[4.0, 6.0, 15.0]]))), state)
    np.testing.assert_allclose(range_.range, 26)


def test_a_tag_sits_where_it_is_mounted():
    """1 m ahead of a vehicle that looks north, and 2 m to the left."""
    installed = Installation("tag", Ranges(target=Anchor(PLACES)), mount=Mount(1.0, 2.0))
    range_ = quick_jit(lambda s: installed.expect(s, jnp.asarray(1)))(POSE)
    np.testing.assert_allclose(range_.range, 5**0.5)


@pytest.mark.parametrize("sensor", [Ranges(biases="own"), Ranges3(biases="own")])
def test_the_contract_holds_with_biases(sensor):
    check_sensor(sensor)


def test_each_anchor_has_its_own_bias():
    radio = Ranges(target=Anchor(PLACES), range_std=0.1, biases="own")
    vehicle = augment(Unicycle(), {"own": Drift()}, (radio,))
    start = vehicle.start()._replace(own=jnp.array([0.0, 0.5]))
    rig = Rig(vehicle, (Installation("radio", radio),), Gaussian(start, jnp.eye(5)))
    assert type(start)._fields == ("position", "heading", "own")
    np.testing.assert_allclose(seen(radio, start, 0)[0].range, 5)
    np.testing.assert_allclose(seen(radio, start, 1)[0].range, 0.5)

    posterior, _ = quick_jit(ExtendedKalman().update)(
        radio.for_target(0), rig.prior, Measurement(jnp.array(5.2)), jnp.zeros(2, jnp.uint32)
    )
    # The anchor's own bias has the prior variance 1, so has the range in the position.
    np.testing.assert_allclose(posterior.mean.own, [0.2 / 2.01, 0.5])


def test_an_anchor_under_the_tag_is_no_trouble():
    posterior, innovation = quick_jit(ExtendedKalman().update)(
        Ranges(target=Anchor(PLACES)).for_target(1),
        Gaussian(POSE, jnp.eye(3)),
        Measurement(jnp.array(0.4)),
        jnp.zeros(2, jnp.uint32),
    )
    assert np.isfinite(posterior.mean.position).all()
    assert np.isfinite(posterior.cov).all()
    np.testing.assert_allclose(innovation.residual, [0.4], atol=1e-8)


def test_a_file_sizes_the_biases_by_its_map(tmp_path):
    path = tmp_path / "yard.toml"
    path.write_text(SCENARIO)
    rig = load_scenario(str(path)).scenario.rig
    np.testing.assert_array_equal(rig.prior.mean.anchor_bias, [0, 0, 0])
    np.testing.assert_allclose(
        np.diag(rig.prior.cov), [1, 1, 0.01, 0.09, 0.09, 0.09, 0.01], rtol=1e-12
    )
    target = rig.sensors[0].sensor.target
    np.testing.assert_array_equal(target.offset, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(target.position_z, np.zeros(3))

    path.write_text(SCENARIO.replace("anchor_bias = {", "bias = {"))
    with pytest.raises(ContractError, match=r"'bias' is neither .* there are anchor_bias"):
        load_scenario(str(path))
    path.write_text(SCENARIO.replace("position_y =", "north ="))
    with pytest.raises(ConfigError, match=r"yard\.toml: sensors\.radio: .*'position_y'"):
        load_scenario(str(path))


@pytest.mark.parametrize(
    ("reading", "verdict"),
    [
        (2.05, Verdict.FUSED),
        (1.6, Verdict.FUSED),
        (1.4, Verdict.NOT_FINITE),
        (-3, Verdict.NOT_FINITE),
    ],
)
def test_shorter_than_the_difference_of_heights(reading, verdict):
    """The anchor is 2 m above the tag: 0.4 m less is noise of 0.1 m, 0.6 m less is not."""
    radio = Ranges(target=Anchor(PLACES, position_z=2.5), range_std=0.1, tag_height=0.5)
    rig = Rig(Unicycle(), (Installation("radio", radio),), Gaussian(POSE, jnp.eye(3)))
    estimator = Estimator(ExtendedKalman(), rig)
    answer = estimator.push(0.0, "radio", Measurement(jnp.array(float(reading))), target=1)
    assert answer.verdict == verdict


@pytest.mark.parametrize("name", ["anchor biases", "class", "_bias"])
def test_biases_need_the_name_of_a_field(name):
    with pytest.raises(ContractError, match=f"biases: found '{name}'"):
        _ = Ranges(biases=name).reads
