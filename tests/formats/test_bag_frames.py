"""Mounts from ``/tf_static``: chains of frames, and what a rig makes of them."""

import json
import math

import numpy as np
import pytest
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from kedge.config.problem import load_problem
from kedge.core.errors import DataError
from kedge.estimation.mount import Mount
from kedge.formats.bag_frames import frames_of

RANDOM = np.random.default_rng(8)


def link(parent, child, arm=(0.0, 0.0, 0.0), turn=None):
    quaternion = (turn or Rotation.identity()).as_quat().tolist()
    return {
        "header": {"frame_id": parent},
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", map(float, arm), strict=True)),
            "rotation": dict(zip("xyzw", quaternion, strict=True)),
        },
    }


def test_a_chain_of_frames_is_one_mount():
    turns = Rotation.from_euler("ZYX", RANDOM.uniform(-1, 1, (2, 3)))
    arms = RANDOM.normal(size=(2, 3))
    links = [
        link("mast", "/imu", arms[1], turns[1]),
        link("base_link", "mast", arms[0], turns[0]),
    ]
    found = frames_of([{"transforms": links[:1]}, {"transforms": links[1:]}], "base_link")[
        "imu"
    ]
    point = RANDOM.normal(size=3)  # as the IMU sees it
    expected = arms[0] + turns[0].apply(arms[1] + turns[1].apply(point))
    mount = Mount(**{k: v for k, v in found._asdict().items() if k != "frame"})
    w, *xyz = np.asarray(mount.body_from_sensor)
    at = np.asarray(mount.arm) + Rotation.from_quat([*xyz, w]).apply(point)
    np.testing.assert_allclose(at, expected, atol=1e-12)


def test_frames_that_do_not_hang_on_the_body_are_none():
    links = [link("map", "tag"), link("a", "b"), link("b", "a"), link("base_link", "gps")]
    assert set(frames_of([{"transforms": links}], "base_link")) == {"gps"}


RIG = """
format = "bag"
[bag.topics.wheels]
topic = "/odom"
stamp = "stamp"
columns.speed = { field = "speed", unit = "m/s" }
columns.yaw_rate = { field = "rate", unit = "rad/s" }
[bag.topics.gnss]
topic = "/fix"
stamp = "stamp"
columns.position_x = { field = "x", unit = "m" }
columns.position_y = { field = "y", unit = "m" }
[vehicle]
model = "unicycle"
[control]
source = "wheels"
[sensors.gnss]
model = "gnss"
[prior]
std = { position = 1.0, heading = 1.0 }
"""


@pytest.fixture
def drive(tmp_path):
    """A rig and a bag of it, with a mast as it is given."""
    (tmp_path / "rig.toml").write_text(RIG)

    def write(links):
        with (tmp_path / "drive.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("any", "jsonschema", b"{}")

            def put(topic, time, content):
                channel = writer.register_channel(topic, "json", schema)
                data = json.dumps(content).encode()
                writer.add_message(channel, log_time=time, publish_time=time, data=data)

            put("/tf_static", 0, links)
            for k in range(5):
                put("/odom", k, {"stamp": k / 2, "speed": 1.0, "rate": 0.0})
                fix = {"header": {"frame_id": "gps"}, "stamp": k / 2, "x": k / 2, "y": 0.0}
                put("/fix", k, fix)
            writer.finish()
        return str(tmp_path / "rig.toml"), str(tmp_path / "drive.mcap")

    return write


def test_a_rig_takes_the_mount_of_its_bag_and_says_so(drive):
    turned = Rotation.from_euler("z", 0.5)
    rig, bag = drive({"transforms": [link("base_link", "gps", (0.4, -0.1, 1.2), turned)]})
    problem = load_problem(rig, bag)
    mount = problem.rig.sensors[0].mount
    np.testing.assert_allclose([mount.x, mount.y, mount.z, mount.heading], [0.4, -0.1, 0, 0.5])
    assert any("gnss: mounted at 0.4, -0.1, 1.2 m" in note for note in problem.notes)


def test_a_mount_of_the_rigs_own_stays(drive):
    rig, bag = drive({"transforms": [link("base_link", "gps", (0.4, 0, 0))]})
    problem = load_problem(rig, bag, overrides={"sensors.gnss.mount": "{ x = 2.0 }"})
    assert problem.rig.sensors[0].mount.x == 2.0
    assert load_problem(rig, bag, overrides={"bag.base": '""'}).rig.sensors[0].mount is None


def test_what_is_tilted_has_no_mount_in_the_plane(drive):
    upside = Rotation.from_euler("x", math.pi)
    problem = load_problem(
        *drive({"transforms": [link("base_link", "gps", (1, 0, 0), upside)]})
    )
    assert problem.rig.sensors[0].mount is None
    assert any("no mount is taken, it is tilted" in note for note in problem.notes)


def test_frames_that_cannot_be_understood_are_refused(drive):
    with pytest.raises(DataError, match="/tf_static"):
        load_problem(*drive({"transforms": [{"transform": 3}]}))
