"""Quaternions in messages: headings and attitudes of bags."""

import json

import numpy as np
import pytest
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from kedge.core.errors import DataError
from kedge.formats.bag_config import BagConfig
from kedge.formats.readers import read_log

RANDOM = np.random.default_rng(5)
TURNS = Rotation.from_euler("ZYX", RANDOM.uniform(-1.5, 1.5, (20, 3)) * [2, 1, 1])


def bag(folder, turns):
    path = folder / "turns.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Imu", "jsonschema", b"{}")
        channel = writer.register_channel("/imu", "json", schema)
        for number, turn in enumerate(turns):
            content = {"stamp": number / 10, "orientation": turn, "speed": 1.0}
            data = json.dumps(content).encode()
            writer.add_message(channel, log_time=number, publish_time=number, data=data)
        writer.finish()
    return str(path)


def quaternions():
    return [dict(zip("xyzw", turn, strict=True)) for turn in TURNS.as_quat().tolist()]


def read(path, **columns):
    topic = {"topic": "/imu", "stamp": "stamp", "columns": columns}
    config = BagConfig.model_validate({"topics": {"imu": topic}})
    return read_log(path, "bag", config).tables["imu"]


def test_a_heading_of_a_quaternion_is_its_yaw(tmp_path):
    heading = {"field": "orientation", "unit": "rad"}
    table = read(bag(tmp_path, quaternions()), heading=heading)
    assert table.units == {"heading": "rad"}
    np.testing.assert_allclose(table.columns["heading"], TURNS.as_euler("ZYX")[:, 0])


def test_an_attitude_is_the_quaternion_with_w_first(tmp_path):
    attitude = {"field": "orientation", "unit": "1"}
    table = read(bag(tmp_path, quaternions()), attitude=attitude)
    found = np.stack([table.columns[f"attitude_{axis}"] for axis in "xyzw"], axis=1)
    np.testing.assert_allclose(found, TURNS.as_quat())


def test_a_quaternion_that_was_never_filled_is_missing(tmp_path):
    nothing = dict.fromkeys("xyzw", 0.0)
    path = bag(tmp_path, [*quaternions()[:3], nothing])
    heading = read(path, heading={"field": "orientation", "unit": "rad"}).columns["heading"]
    assert np.isnan(heading).tolist() == [False, False, False, True]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            {"heading": {"field": "orientation.z", "unit": "rad"}},
            "'orientation.z' is a component of a quaternion, not an angle",
        ),
        ({"roll": {"field": "orientation", "unit": "rad"}}, "a column called heading"),
        ({"heading": {"field": "orientation", "unit": "deg"}}, "'deg', expected 'rad'"),
        ({"attitude": {"field": "speed", "unit": "1"}}, "found no quaternion"),
    ],
)
def test_what_no_quaternion_can_be_is_refused(columns, message, tmp_path):
    with pytest.raises(DataError, match=message):
        read(bag(tmp_path, quaternions()), **columns)


def test_a_quaternion_that_is_no_rotation_is_refused(tmp_path):
    wrong = {axis: 2.0 * value for axis, value in quaternions()[0].items()}
    with pytest.raises(DataError, match=r"message 1: 'orientation': .* of length 2"):
        read(bag(tmp_path, [wrong]), heading={"field": "orientation", "unit": "rad"})


def test_components_without_an_angle_stay_numbers(tmp_path):
    """What the log of an attitude sensor always did."""
    table = read(bag(tmp_path, quaternions()), z={"field": "orientation.z", "unit": "1"})
    np.testing.assert_allclose(table.columns["z"], TURNS.as_quat()[:, 2])
