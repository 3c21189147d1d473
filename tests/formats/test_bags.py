"""Bags of every kind, written here by the libraries that read them: each gives the same log."""

import json
import random
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kedge.config.rigs import load_rig_config
from kedge.core.errors import ConfigError, DataError
from kedge.formats.bag_config import BagConfig
from kedge.formats.readers import read_log

RANGE = "uint16 id\nfloat32 metres\n"
SCAN = "std_msgs/Header header\nuwb/Range[] ranges\n"
TIMES = (10.5, 10.6)
KINDS = "bag", "sqlite3", "mcap folder", "mcap file", "json", "protobuf"


def config(**changes) -> BagConfig:
    topic = {
        "topic": "/uwb",
        "each": "ranges",
        "target": "id",
        "columns": {"range": {"field": "metres", "unit": "cm"}},
    }
    return BagConfig.model_validate({"topics": {"radio": topic | changes}})


def types(store: Stores):
    found = get_typestore(store)
    known = get_types_from_msg(RANGE, "uwb/msg/Range") | get_types_from_msg(
        SCAN, "uwb/msg/Scan"
    )
    found.register(known)
    return found


def scans(store, first: bool):
    """Two scans of anchors 7 and 8; ROS 1 headers have a number besides."""
    time, header = (
        store.types["builtin_interfaces/msg/Time"],
        store.types["std_msgs/msg/Header"],
    )
    one, scan = store.types["uwb/msg/Range"], store.types["uwb/msg/Scan"]
    for number, at in enumerate(TIMES):
        stamp = time(sec=int(at), nanosec=round((at % 1) * 1e9))
        head = {"seq": number} if first else {}
        ranges = [one(id=7 + k, metres=100.0 * (1 + number) + k) for k in range(2)]
        yield scan(header=header(stamp=stamp, frame_id="", **head), ranges=ranges)


def protobuf():
    """A scan as protobuf knows it: its class, and the definition that a file carries."""
    file = FileDescriptorProto(name="uwb.proto", package="uwb", syntax="proto3")
    fields = {
        "Time": {"sec": (5, 1, ""), "nanosec": (5, 1, "")},  # int32, one of them
        "Header": {"stamp": (11, 1, ".uwb.Time")},  # a message
        "Range": {"id": (5, 1, ""), "metres": (2, 1, "")},  # float
        "Scan": {"header": (11, 1, ".uwb.Header"), "ranges": (11, 3, ".uwb.Range")},
    }
    for name, own in fields.items():
        message = file.message_type.add(name=name)
        for number, (field, (kind, label, of)) in enumerate(own.items(), 1):
            known = {"type_name": of} if of else {}
            message.field.add(name=field, number=number, type=kind, label=label, **known)
    pool = DescriptorPool()
    pool.Add(file)
    scan = GetMessageClass(pool.FindMessageTypeByName("uwb.Scan"))
    return scan, FileDescriptorSet(file=[file]).SerializeToString()


def mcap(path: Path, kind: str) -> Path:
    """The scans as JSON or as protobuf, neither of which ROS knows."""
    scan, definition = protobuf()
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        if kind == "json":
            schema = writer.register_schema("uwb.Scan", "jsonschema", b"{}")
        else:
            schema = writer.register_schema("uwb.Scan", "protobuf", definition)
        channel = writer.register_channel("/uwb", kind, schema)
        for number, at in enumerate(TIMES):
            ranges = [{"id": 7 + k, "metres": 100.0 * (1 + number) + k} for k in range(2)]
            stamp = {"sec": int(at), "nanosec": round((at % 1) * 1e9)}
            content = {"header": {"stamp": stamp}, "ranges": ranges}
            data = json.dumps(content).encode()
            if kind == "protobuf":
                data = scan(**content).SerializeToString()
            time = int(at * 1e9) + 5000
            writer.add_message(channel, log_time=time, publish_time=time, data=data)
        writer.finish()
    return path


def write(folder: Path, kind: str) -> Path:
    if kind == "bag":
        path, store = folder / "drive.bag", types(Stores.ROS1_NOETIC)
        with Writer1(path) as writer:
            topic = writer.add_connection("/uwb", "uwb/msg/Scan", typestore=store)
            for at, scan in zip(TIMES, scans(store, True), strict=True):
                data = store.serialize_ros1(scan, "uwb/msg/Scan")
                writer.write(topic, int(at * 1e9) + 5000, data)
        return path
    store = types(Stores.ROS2_HUMBLE)
    if kind in ("json", "protobuf"):
        return mcap(folder / "drive.mcap", kind)
    path = folder / "drive"
    plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        topic = writer.add_connection("/uwb", "uwb/msg/Scan", typestore=store)
        for at, scan in zip(TIMES, scans(store, False), strict=True):
            data = store.serialize_cdr(scan, "uwb/msg/Scan")
            writer.write(topic, int(at * 1e9) + 5000, data)
    return next(path.glob("*.mcap")) if kind == "mcap file" else path


@pytest.mark.parametrize("kind", KINDS)
def test_a_message_that_the_bag_itself_defines(tmp_path, kind):
    raw = read_log(str(write(tmp_path, kind)), "bag", config())
    radio = raw.tables["radio"]
    assert radio.stamps.tolist() == [10_500_000_000] * 2 + [10_600_000_000] * 2
    assert radio.texts == {"target": ["7", "8", "7", "8"]}
    np.testing.assert_allclose(radio.columns["range"], [1.0, 1.01, 2.0, 2.01])
    assert radio.lines.tolist() == [1, 1, 2, 2]
    assert radio.units == {"range": "m"}
    assert raw.files


def test_the_time_of_recording_another_clock_and_a_map(tmp_path):
    path = str(write(tmp_path, "bag"))
    raw = read_log(path, "bag", config(stamp="bag", offset=1.0))
    assert raw.tables["radio"].stamps[0] == 11_500_005_000

    spec = config().model_dump()
    places = {"position_x": {"field": "metres", "unit": "m"}}
    spec["maps"] = {"anchors": spec["topics"]["radio"] | {"columns": places}}
    targets = read_log(path, "bag", BagConfig.model_validate(spec)).maps["anchors"]
    assert targets.ids == ("7", "8")
    np.testing.assert_allclose(targets.columns["position_x"], [100.0, 101.0])


def test_what_is_wrong_with_a_bag(tmp_path):
    path = write(tmp_path, "bag")

    def refused(pattern, **changes):
        with pytest.raises(DataError, match=pattern):
            read_log(str(path), "bag", config(**changes))

    refused(r"no topic '/imu' \(for radio\); there are /uwb \(uwb/msg/Scan\)", topic="/imu")
    refused(r"uwb/msg/Scan\), message 1: no 'scans' .* there are header, ranges", each="scans")
    refused(r"no 'feet' on the way 'feet'; there are id, metres", columns=feet())
    refused(r"'header': found a \w+, expected a number", each=None, target=None, columns=head())
    refused(r"expected a time; stamp = \"bag\"", stamp="header")
    with pytest.raises(ConfigError, match=r"bag: this table is missing"):
        read_log(str(path), "bag")
    with pytest.raises(DataError, match=r"no such file"):
        read_log(str(path) + "x", "bag", config())
    path.write_bytes(b"nonsense")
    refused("cannot be read as a bag")
    (tmp_path / "drive.mcap").write_bytes(b"nonsense")
    with pytest.raises(DataError, match=r"cannot be read as MCAP"):
        read_log(str(tmp_path / "drive.mcap"), "mcap", config())


def feet():
    return {"range": {"field": "feet", "unit": "m"}}


def head():
    return {"range": {"field": "header", "unit": "m"}}


def test_messages_of_an_unknown_encoding(tmp_path):
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("uwb/msg/Scan", "ros2msg", b"what is this?\n")
        for topic, encoding in (("/uwb", "cdr"), ("/odd", "flatbuffer")):
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, log_time=1, publish_time=1, data=b"\0" * 20)
        writer.finish()
    with pytest.raises(
        DataError, match=r"'/uwb' \(uwb/msg/Scan\), message 1: cannot be decoded"
    ):
        read_log(str(path), "mcap", config())
    with pytest.raises(DataError, match=r"encoded as 'flatbuffer', expected ros1, cdr"):
        read_log(str(path), "mcap", config(topic="/odd"))


def test_a_rig_file_with_topics(tmp_path):
    rig = load_rig_config("isas_walk")
    assert rig.bag is not None
    assert rig.bag.topics["radio"].each == "ranges"
    changes = {"bag.topics.radio.columns.range.unit": "mile", "bag.truth": "nobody"}
    with pytest.raises(ConfigError, match=r"(?s)unit.*'mile'|nobody"):
        load_rig_config("isas_walk", changes)


@pytest.mark.parametrize("kind", ["bag", "mcap file", "json", "protobuf"])
def test_a_damaged_bag_is_refused_or_read(tmp_path, kind):
    """Whatever the decoding library raises, it is one kind of error."""
    path = write(tmp_path, kind)
    good, noticed = path.read_bytes(), 0
    for seed in range(90):
        draw, data = random.Random(seed), bytearray(good)
        data[draw.randrange(len(data))] = draw.randrange(256)
        path.write_bytes(data[: draw.randrange(len(data))] if seed % 3 == 0 else data)
        try:
            noticed += bool(read_log(str(path), "bag", config()).notes)
        except DataError:
            noticed += 1
    assert 30 <= noticed < 90


def test_a_chunk_whose_checksum_is_wrong_is_refused(tmp_path):
    path = tmp_path / "plain.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        for number in range(3):
            data = json.dumps({"stamp": number, "value": 1234.5}).encode()
            writer.add_message(channel, log_time=number, publish_time=number, data=data)
        writer.finish()
    columns = {"range": {"field": "value", "unit": "m"}}
    topic = {"topic": "/x", "stamp": "stamp", "columns": columns}
    known = BagConfig.model_validate({"topics": {"radio": topic}})
    assert read_log(str(path), "bag", known).tables["radio"].columns["range"][1] == 1234.5
    path.write_bytes(path.read_bytes().replace(b"1234.5", b"9234.5", 1))
    with pytest.raises(
        DataError, match=r"plain\.mcap: cannot be read as MCAP after 0 mess.*CRC"
    ):
        read_log(str(path), "bag", known)


@pytest.fixture
def whole(tmp_path):
    """Forty messages in several chunks, and what of the file to read them takes."""
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=400)
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        for number in range(40):
            data = json.dumps({"stamp": number, "value": 1.5 * number}).encode()
            writer.add_message(channel, log_time=number * 10**9, publish_time=0, data=data)
        writer.finish()
    columns = {"range": {"field": "value", "unit": "m"}}
    topic = {"topic": "/x", "stamp": "stamp", "columns": columns}
    return path, BagConfig.model_validate({"topics": {"radio": topic}})


def test_a_recording_that_was_not_closed_is_read_as_far_as_it_is_whole(whole):
    path, topics = whole
    data = path.read_bytes()
    complete = read_log(str(path), "bag", topics)
    assert not complete.notes
    for size, zeros in ((len(data) // 2, 0), (len(data) // 2, 4096), (len(data) - 200, 0)):
        path.write_bytes(data[:size] + bytes(zeros))
        raw = read_log(str(path), "bag", topics)
        rows = len(raw.tables["radio"].stamps)
        assert (rows == 40) == (size == len(data) - 200)
        assert rows > 5
        expected = complete.tables["radio"].columns["range"][:rows]
        np.testing.assert_array_equal(raw.tables["radio"].columns["range"], expected)
        assert raw.notes[0].startswith(f"drive.mcap: it was not closed; {rows} messages, of")


def test_what_is_no_recording_is_refused(whole):
    path, topics = whole
    good = path.read_bytes()
    for data, message in (
        (b"", "cannot be read as MCAP: its first bytes"),
        (b"time,x\n0,1\n", "cannot be read as MCAP: its first bytes"),
        (good[:8], "cannot be read as MCAP after 0 messages"),
        (good[:60], "cannot be read as MCAP after 0 messages"),
    ):
        path.write_bytes(data)
        with pytest.raises(DataError, match=message):
            read_log(str(path), "bag", topics)


def test_a_folder_without_metadata_is_read_by_its_parts(whole, tmp_path):
    path, topics = whole
    folder = tmp_path / "ros2"
    folder.mkdir()
    with pytest.raises(DataError, match=r"neither metadata.yaml nor .mcap files"):
        read_log(str(folder), "bag", topics)
    (folder / "part_0.mcap").write_bytes(path.read_bytes())
    raw = read_log(str(folder), "bag", topics)
    assert len(raw.tables["radio"].stamps) == 40
    assert raw.notes == ("ros2: no metadata.yaml; its 1 MCAP files were read by name",)


def test_stamps_as_dates(tmp_path):
    table = values(tmp_path / "x.mcap", [{"t": "2024-05-10T14:00:00.5+02:00", "v": 1}])
    assert table.stamps.tolist() == [1715342400_500_000_000]


def values(path, rows):
    """A recording in JSON whose messages are these."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        for at, row in enumerate(rows):
            data = json.dumps(row).encode()
            writer.add_message(channel, log_time=at, publish_time=at, data=data)
        writer.finish()
    columns = {"range": {"field": "v", "unit": "m"}}
    topic = {"topic": "/x", "stamp": "t", "columns": columns}
    return read_log(
        str(path), "bag", BagConfig.model_validate({"topics": {"radio": topic}})
    ).tables["radio"]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"t": float("nan"), "v": 1}, "'t': found nan, expected a time"),
        ({"t": 1.7e18, "v": 1}, "'t': found a time beyond 292 years from 0, expected one in s"),
        ({"t": {"sec": "x", "nanosec": 0}, "v": 1}, "expected two whole numbers"),
        ({"t": 1, "v": 10**400}, "'v': found a int, expected a number"),
    ],
    ids=["nan", "nanoseconds", "text", "a long number"],
)
def test_a_value_that_is_none_is_named_with_its_message(tmp_path, row, message):
    with pytest.raises(DataError, match=f"topic '/x' .*message 2: .*{message}"):
        values(tmp_path / "x.mcap", [{"t": 0, "v": 1}, row])


@pytest.mark.parametrize(
    ("times", "looks"),
    [
        ([0, 10, 20, 30, 0.5, 10.5], "a second playing of the recording"),
        ([86_395, 86_399, 1, 2], "midnight in stamps without a date"),
        ([604_790, 604_799, 0, 1], "a new GPS week"),
    ],
    ids=["played twice", "midnight", "week"],
)
def test_time_that_jumps_back_is_refused_and_what_is_late_is_sorted(tmp_path, times, looks):
    with pytest.raises(DataError, match=f"expected it to go back by at most 5 s; .*{looks}"):
        values(tmp_path / "x.mcap", [{"t": at, "v": 1} for at in times])
    late = values(tmp_path / "x.mcap", [{"t": at, "v": at} for at in (0, 4, 2, 8)])
    assert late.columns["range"].tolist() == [0, 2, 4, 8]


def test_a_map_from_a_bag_passes_the_checks_of_a_folder(tmp_path):
    def read(anchors):
        path = tmp_path / "map.mcap"
        with path.open("wb") as file:
            writer = McapWriter(file)
            writer.start()
            for topic, content in (("/x", {"t": 0, "v": 1}), ("/map", {"anchors": anchors})):
                channel = writer.register_channel(topic, "json", 0)
                data = json.dumps(content).encode()
                writer.add_message(channel, log_time=0, publish_time=0, data=data)
            writer.finish()
        columns = {"position_x": {"field": "x", "unit": "m"}}
        spec = {"topic": "/map", "each": "anchors", "target": "id", "columns": columns}
        value = {"range": {"field": "v", "unit": "m"}}
        topics = {"radio": {"topic": "/x", "stamp": "t", "columns": value}}
        known = BagConfig.model_validate({"topics": topics, "maps": {"anchors": spec}})
        return read_log(str(path), "bag", known).maps["anchors"]

    assert read([{"id": 1, "x": 2.0}]).ids == ("1",)
    for anchors, message in (
        ([], "a map without targets"),
        ([{"id": 1, "x": 2.0}, {"id": 1, "x": 3.0}], "target '1' twice"),
        ([{"id": 1, "x": float("nan")}], "target '1': expected a finite number"),
        ({"id": 1}, "'anchors': found a dict, expected a list"),
    ):
        with pytest.raises(DataError, match=message):
            read(anchors)
