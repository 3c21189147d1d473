from pathlib import Path

import numpy as np
import pytest

from kedge.core.errors import DataError, UnknownName
from kedge.formats.logs import RawLog, TargetMap, digest_inputs, write_log
from kedge.formats.readers import read_log
from kedge.formats.tables import Table

AWKWARD = [0.1, -0.0, 1 / 3, 5e-324, 1.7976931348623157e308, np.nan]


def source(name: str, columns: dict, texts: dict | None = None, units: str = "m") -> Table:
    count = len(next(iter(columns.values())))
    return Table(
        name,
        Path("memory"),
        1248272265123456789 + 10 * np.arange(count, dtype=np.int64),
        {key: np.array(values) for key, values in columns.items()},
        texts or {},
        np.arange(2, count + 2),
        dict.fromkeys(columns, units),
    )


@pytest.fixture
def raw() -> RawLog:
    return RawLog(
        'a "quoted" title \\ Ü',
        {
            "gnss": source(
                "gnss", {"position_x": AWKWARD, "position_y": [*AWKWARD[:-1], np.inf]}
            ),
            "uwb": source("uwb", {"range": [1.0, 2.0]}, {"tag": ["a,b", '"c"']}),
        },
        source("truth", {"position_x": [0.0, 1.0], "position_y": [2.0, 3.0]}),
        {"anchors": TargetMap(("a,b", '"c"'), {"position_x": np.array([0.1, 2.0])})},
        epoch="Unix",
    )


def same(one: Table | None, other: Table | None) -> None:
    assert one is not None
    assert other is not None
    assert one.name == other.name
    assert one.stamps.tobytes() == other.stamps.tobytes()
    assert one.columns.keys() == other.columns.keys()
    for name, values in one.columns.items():
        assert values.tobytes() == other.columns[name].tobytes()
    assert (one.texts, one.units) == (other.texts, other.units)


def test_what_is_written_reads_back_bit_for_bit(tmp_path, raw):
    write_log(tmp_path / "deep" / "log", raw)
    back = read_log(str(tmp_path / "deep" / "log"))

    assert (back.title, back.epoch) == (raw.title, raw.epoch)
    for name, table in raw.tables.items():
        same(table, back.tables[name])
    same(raw.truth, back.truth)
    assert back.maps["anchors"].ids == raw.maps["anchors"].ids
    np.testing.assert_array_equal(back.maps["anchors"].columns["position_x"], [0.1, 2.0])
    names = {path.name for path in back.files}
    assert names == {"log.toml", "gnss.csv", "uwb.csv", "truth.csv", "map_anchors.csv"}
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["log"]

    write_log(tmp_path / "twice", back)
    again = read_log(str(tmp_path / "twice"))
    assert digest_inputs(again) == digest_inputs(back)
    (tmp_path / "twice" / "uwb.csv").write_text("time,tag,range\n0,a,1\n")
    assert digest_inputs(again) != digest_inputs(back)


def test_nothing_is_overwritten_and_nothing_half_written(tmp_path, raw):
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "mine").touch()
    with pytest.raises(DataError, match="the folder is not empty"):
        write_log(tmp_path / "log", raw)
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="is a file"):
        write_log(tmp_path / "file", raw)
    with pytest.raises(DataError, match="cannot be written"):
        write_log(tmp_path / "file" / "below", raw)
    with pytest.raises(DataError, match="found source 'a/b'"):
        write_log(tmp_path / "new", raw._replace(tables={"a/b": raw.tables["uwb"]}))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "log"]


def folder(tmp_path: Path, toml: str, **files: str) -> str:
    (tmp_path / "log.toml").write_text(toml)
    for name, text in files.items():
        (tmp_path / f"{name}.csv").write_text(text)
    return str(tmp_path)


def test_units_names_and_frames_are_converted(tmp_path):
    log = folder(
        tmp_path,
        """
        frame = "ned"
        truth = "ref"
        [sources.compass]
        time_unit = "ms"
        columns.hdg = { unit = "deg", name = "heading" }
        columns.rot = { unit = "deg/s", name = "yaw_rate" }
        [sources.ref]
        columns = { position_x = "km", position_y = "m" }
        [sources.log]
        frame = "enu"
        columns = { position_x = "ft" }
        [maps.marks]
        ids = ["1"]
        values = { position_x = [1.0], position_y = [2.0] }
        columns = { position_x = "m", position_y = "m" }
        """,
        compass="time,hdg,rot\n1500,90,180\n",
        ref="time,position_x,position_y\n0,1,7\n",
        log="time,position_x\n0,10\n",
    )
    raw = read_log(log)
    compass = raw.tables["compass"]
    assert compass.stamps.tolist() == [1_500_000_000]
    np.testing.assert_allclose(compass.columns["heading"], [0.0], atol=1e-15)
    np.testing.assert_allclose(compass.columns["yaw_rate"], [-np.pi])
    assert compass.units == {"heading": "rad", "yaw_rate": "rad/s"}
    assert raw.truth is not None
    # A kilometre north and seven metres east.
    np.testing.assert_allclose(raw.truth.columns["position_y"], [1000.0])
    np.testing.assert_allclose(raw.truth.columns["position_x"], [7.0])
    np.testing.assert_allclose(raw.tables["log"].columns["position_x"], [3.048])
    np.testing.assert_allclose(raw.maps["marks"].columns["position_x"], [2.0])


def test_every_mistake_in_log_toml_is_reported_with_its_line_and_key(tmp_path):
    log = folder(
        tmp_path,
        'truth = "refrence"\n'
        "[sources.reference]\n"
        'tmie = "t"\n'
        'time_unit = "h"\n'
        "[sources.gnss.columns]\n"
        'position_x = "furlong"\n',
    )
    with pytest.raises(DataError) as caught:
        read_log(log)
    lines = str(caught.value).splitlines()
    toml = f"{log}/log.toml"
    assert any(
        line.startswith(
            f"{toml}:3: sources.reference.tmie: no key called 'tmie' (did you mean 'time'"
        )
        for line in lines
    )
    assert any(
        line.startswith(
            f"{toml}:6: sources.gnss.columns.position_x.unit: no unit called 'furlong'"
        )
        for line in lines
    )


@pytest.mark.parametrize(
    ("toml", "csv", "message"),
    [
        ('[sources.gnss]\ncolumns = { x = "m" }', None, "gnss.csv: no such file"),
        ("[sources.gnss\n", "", "log.toml:1: no readable TOML"),
        ("[sources]\n", "", "log.toml: sources: empty log"),
        (
            '[sources.gnss]\n[maps.m]\nids = ["a"]\ncolumns = { x = "m" }',
            "",
            "log.toml:2: maps.m.values.x: found 0 numbers, expected 1",
        ),
        ('truth = "a"\n[sources.gnss]', "", "log.toml:1: truth: no source called 'a'"),
        (
            '[sources.gnss]\ntime_unit = "h"',
            "",
            "log.toml:2: sources.gnss.time_unit: no unit of time",
        ),
        (
            'truth = "gnss"\n[sources.gnss]\ncolumns = { x = "m" }',
            "time,x\n0,1\n1,\n",
            "gnss.csv:3: column 'x': found nothing, expected a finite number: truth",
        ),
    ],
)
def test_what_is_wrong_with_a_folder(tmp_path, toml, csv, message):
    log = folder(tmp_path, toml, **({} if csv is None else {"gnss": csv}))
    with pytest.raises(DataError) as caught:
        read_log(log)
    assert message in str(caught.value)


def test_logs_that_are_not_there(tmp_path):
    with pytest.raises(DataError, match="no such folder"):
        read_log(str(tmp_path / "none"))
    with pytest.raises(DataError, match=r"log.toml: no such file"):
        read_log(str(tmp_path))
    with pytest.raises(DataError, match="found part '3'"):
        read_log(f"{tmp_path}#3")
    with pytest.raises(
        UnknownName, match=r"no log format called 'mrclan' \(did you mean 'mrclam'"
    ):
        read_log(str(tmp_path), "mrclan")


def test_a_file_of_another_format_brings_its_sources(tmp_path):
    track = """<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="48.0" lon="9.0"><time>2024-05-10T12:00:00Z</time></trkpt>
<trkpt lat="48.0" lon="9.001"><time>2024-05-10T12:00:01Z</time></trkpt></trkseg></trk></gpx>"""
    toml = 'files = { "way.gpx" = "gpx" }\n[sources.imu]\ncolumns = { yaw_rate = "deg/s" }\n'
    path = folder(tmp_path, toml, imu="time,yaw_rate\n2024-05-10T12:00:00.5Z,1\n")
    (Path(path) / "way.gpx").write_text(track)
    raw = read_log(path)
    assert set(raw.tables) == {"imu", "gnss"}
    assert raw.tables["gnss"].stamps[1] - raw.tables["imu"].stamps[0] == 500_000_000
    assert Path(path) / "way.gpx" in raw.files  # and so in the digest
    log = Path(path) / "log.toml"
    log.write_text(toml.replace("imu", "gnss"))
    (Path(path) / "imu.csv").rename(Path(path) / "gnss.csv")
    with pytest.raises(DataError, match=r"files.way.gpx: found a source 'gnss' that there is"):
        read_log(path)
    (Path(path) / "gnss.csv").rename(Path(path) / "imu.csv")
    for said, message in (
        (toml.replace('"gpx"', '"gpy"'), r"log.toml:1: files.way.gpx: no format of one file"),
        (toml.replace('"gpx"', '"bag"'), r"no format of one file called 'bag'"),
        (f'truth = "vicon"\n{toml}', r"truth: no source called 'vicon'"),
    ):
        log.write_text(said)
        with pytest.raises(DataError, match=message):
            read_log(path)


def test_a_covariance_in_a_map_of_ned_is_refused(tmp_path):
    toml = """[sources.imu]
columns = { yaw_rate = "deg/s" }
[maps.posts]
ids = ["a"]
frame = "ned"
values = { position_x = [1.0], xx = [0.1] }
columns = { position_x = "m", xx = "m^2" }
"""
    with pytest.raises(DataError, match="column 'xx': a map's covariance cannot be converted"):
        read_log(folder(tmp_path, toml, imu="time,yaw_rate\n0,1\n"))
