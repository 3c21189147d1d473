"""``kedge init``: a rig that runs, from files that nobody declared; ``kedge show``."""

import functools
import json
import operator
import tomllib
from datetime import datetime, timedelta

import numpy as np
import pytest
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from kedge.apps.first_rig import is_planar
from kedge.apps.init import init, show
from kedge.config.problem import load_problem
from kedge.config.rigs import load_rig_config
from kedge.core.errors import DataError
from kedge.formats.readers import read_log

TIME = np.arange(0, 20, 0.1)
TURN = 0.3 * np.sin(0.4 * TIME)
HEADING = np.cumsum(TURN) * 0.1 + 1.5
X, Y = (np.cumsum(f(HEADING)) * 0.1 for f in (np.cos, np.sin))


def write(folder, name, **columns):
    rows = np.column_stack(list(columns.values()))
    np.savetxt(folder / name, rows, "%.6f", ",", header=",".join(columns), comments="")


@pytest.fixture
def log(tmp_path):
    folder = tmp_path / "drive"
    folder.mkdir()
    stamps = np.round(1e3 * (TIME + 1.7e9))
    write(
        folder, "wheels.csv", stamp=stamps, v=1 + 0 * X, yaw_rate=400 * np.degrees(TURN) / 400
    )
    write(folder, "gps.csv", time=stamps, east=X, north=Y, hdop=0 * X)
    write(folder, "imu.csv", timestamp=stamps, yaw=np.degrees(HEADING))
    write(folder, "ground_truth.csv", time=stamps, x=X, y=Y, theta=HEADING)
    (folder / "notes.txt").write_text("what was done that day\nnothing\n")
    return folder


def test_a_folder_gets_a_log_and_a_rig_that_run(log):
    written, notes, missing = init(log, None)
    assert [path.name for path in written] == ["log.toml", "rig.toml"]
    assert missing == ""
    problem = load_problem(str(log / "rig.toml"), str(log))
    assert set(problem.rig.names) == {"gps", "imu"}
    said = tomllib.loads((log / "log.toml").read_text())
    assert said["truth"] == "ground_truth"
    assert said["sources"]["imu"]["columns"]["yaw"] == {"unit": "deg", "name": "heading"}
    assert said["sources"]["wheels"]["time_unit"] == "ms"
    assert "hdop" in (log / "log.toml").read_text()
    assert "notes.txt was left out" in (log / "log.toml").read_text()
    assert [note.split(":")[0] for note in notes] == ["notes.txt was left out"]
    end = np.asarray(problem.truth.fields["position"])[-1]
    np.testing.assert_allclose(end, [X[-1], Y[-1]], atol=1e-3)


def test_an_attitude_of_three_angles_in_ned(tmp_path):
    """What a reference under water tells: degrees on earth, the compass, roll, pitch, yaw."""
    angles = {"Roll [rad]": 0 * X, "Pitch [rad]": 0 * X + 0.1, "Yaw [rad]": np.pi / 2 - HEADING}
    speeds = {"V North": 0 * X, "V East": 0 * X, "V Down": 0 * X}
    place = {"lat": 32 + Y / 111_000, "lon": 34 + X / 94_000, "alt": 0 * X - 10}
    write(tmp_path, "GT.csv", time=TIME, **place, **speeds, **angles)
    write(tmp_path, "dvl.csv", time=TIME, **{f"DVL {axis}": 1.0 + 0 * X for axis in "XYZ"})
    missing = init(tmp_path, None).missing
    assert missing == ""
    problem = load_problem(str(tmp_path / "rig.toml"), str(tmp_path))
    assert problem.rig.names == ("dvl",)
    turn = np.asarray(problem.truth.fields["attitude"])[-1]
    nose = Rotation.from_quat(turn[[1, 2, 3, 0]]).apply([1.0, 0, 0])
    up = np.sin(0.1)  # a pitch of 0.1 rad in NED is nose up
    ahead = np.cos(0.1) * np.array([np.cos(HEADING[-1]), np.sin(HEADING[-1])])
    np.testing.assert_allclose(nose, [*ahead, up], atol=1e-4)


def test_a_spreadsheet_of_another_tongue(tmp_path):
    """Dates, decimal commas, a row of units, dashes for what is missing."""
    start = datetime(2025, 3, 14, 9, 26, 53)
    dates = [(start + timedelta(seconds=at)).isoformat() for at in TIME]

    def sheet(name, header, *columns):
        rows = [";".join(row) for row in zip(dates, *columns, strict=True)]
        (tmp_path / name).write_text("\n".join([header, *rows]), encoding="latin-1")

    def comma(values):
        return [f"{value:.6f}".replace(".", ",") for value in values]

    there = comma(X)
    there[7] = "-"
    turn = comma(np.degrees(TURN))
    sheet(
        "Antrieb.csv", "Zeit;Geschwindigkeit;Drehrate\n[-];[m/s];[°/s]", comma(1 + 0 * X), turn
    )
    sheet("Messung.csv", "Zeit;Ost;Nord\n[-];[m];[m]", there, comma(Y))
    sheet("Referenz.csv", "Zeit;Ost;Nord\n[-];[m];[m]", comma(X), comma(Y))
    assert init(tmp_path, None).missing == ""
    problem = load_problem(str(tmp_path / "rig.toml"), str(tmp_path))
    assert problem.rig.names == ("Messung",)
    end = np.asarray(problem.truth.fields["position"])[-1]
    np.testing.assert_allclose(end, [X[-1], Y[-1]], atol=1e-5)


def test_tables_between_blanks_ticks_and_a_file_of_anchors(tmp_path):
    ms = np.round(1e3 * (TIME + 1.7e9))
    at = np.arange(len(TIME))
    (tmp_path / "anchors.txt").write_text("id x_mm y_mm\n0xA 0 0\n0xB 40000 0\n")
    rows = [f"{t:.0f} {'0xA' if k % 2 else '0xB'} {9000 + k}" for k, t in enumerate(ms)]
    (tmp_path / "ranges.txt").write_text("\n".join(["timestamp_ms anchor_id range_mm", *rows]))
    left, right = (65_000 + 100 * at) % 65_536, (100 + 90 * at) % 65_536
    rows = [f"{t:.0f} {a} {b}" for t, a, b in zip(ms, left, right, strict=True)]
    (tmp_path / "wheels.txt").write_text("\n".join(["timestamp_ms left right", *rows]))
    assert init(tmp_path, None).missing == ""
    config = load_rig_config(str(tmp_path / "rig.toml"))
    assert (config.vehicle.model, config.control.sampling) == ("odometry", "counts")
    assert config.control.counter == 65_536
    assert config.sensors["ranges"].map == "anchors"
    anchors = read_log(str(tmp_path)).maps["anchors"]
    assert anchors.columns["position_x"].tolist() == [0.0, 40.0]


def test_a_body_is_in_ned_where_places_are(tmp_path):
    """Depths that are told downwards, and a Doppler log whose axes have no names."""
    write(tmp_path, "usbl.csv", time=TIME, north=Y, east=X, down=5 + 0 * X)
    write(tmp_path, "dvl.csv", time=TIME, vx=1 + 0 * X, vy=0.1 + 0 * X, vz=0.2 + 0 * X)
    compass = np.degrees(np.pi / 2 - HEADING) % 360
    write(tmp_path, "ahrs.csv", time=TIME, roll=2 + 0 * X, pitch=0 * X, yaw=compass)
    write(tmp_path, "depth.csv", time=TIME, depth=5 + 0 * X)
    assert init(tmp_path, None).missing == ""
    raw = read_log(str(tmp_path))
    assert load_rig_config(str(tmp_path / "rig.toml")).sensors["depth"].model == "depth"
    np.testing.assert_allclose(raw.tables["usbl"].columns["position_z"], -5.0)
    np.testing.assert_allclose(raw.tables["usbl"].columns["position_x"], X, atol=1e-5)
    dvl = raw.tables["dvl"].columns
    assert [dvl[f"velocity_body_{axis}"][0] for axis in "xyz"] == [1.0, -0.1, -0.2]
    turn = [raw.tables["ahrs"].columns[f"attitude_{part}"][0] for part in "xyzw"]
    heading, _, roll = Rotation.from_quat(turn).as_euler("ZYX")
    assert heading == pytest.approx(HEADING[0], abs=1e-4)
    assert roll == pytest.approx(np.radians(2.0), abs=1e-4)


def test_a_receivers_file_alone_and_beside_tables(tmp_path):
    lines = []
    for at in range(60):
        text = f"GPGGA,1200{at:02d}.00,4800.{at:05d},N,00900.0000,E,1,9,0.8,500,M,48,M,,"
        lines.append(f"${text}*{functools.reduce(operator.xor, map(ord, text)):02X}")
    (tmp_path / "gps.nmea").write_text("\n".join(lines))
    assert init(tmp_path / "gps.nmea", tmp_path / "alone").missing == ""
    alone = load_rig_config(str(tmp_path / "alone" / "rig.toml"))
    assert (alone.format, alone.sensors["gnss"].model) == ("nmea", "gnss3")
    write(tmp_path, "wheels.csv", t_s=TIME + 43_200, v=1 + 0 * X, yaw_rate=TURN)
    assert init(tmp_path, None).missing == ""
    config = load_rig_config(str(tmp_path / "rig.toml"))
    assert (config.vehicle.model, config.sensors["gnss"].model) == ("unicycle", "gnss")
    assert "gnss_bias" in config.vehicle.augmented


def test_of_several_runs_the_first_is_taken(tmp_path):
    for run in (1, 2):
        write(tmp_path, f"GT_{run}.csv", time=TIME, x=X, y=Y, heading=HEADING)
        write(tmp_path, f"wheels_{run}.csv", time=TIME, v=1 + 0 * X, yaw_rate=TURN)
    tags = ("gps1", "gps2", "gps3")
    for tag in tags:
        write(tmp_path, f"{tag}.csv", time=TIME, east=X, north=Y)
    notes = init(tmp_path, None).notes
    left_out = {note.partition(" ")[0] for note in notes}
    assert left_out == {"GT_2.csv", "wheels_2.csv"}
    assert "of another run; there are 2, and this is that of GT_1" in notes[0]
    assert load_problem(str(tmp_path / "rig.toml"), str(tmp_path)).rig.names == tags


def test_a_truth_with_axes_of_its_own(tmp_path):
    """Fixes and truth show the same path, turned and moved."""
    write(tmp_path, "tag.csv", time=TIME, x=X, y=Y)
    write(tmp_path, "mocap.csv", time=TIME, x=3 - Y, y=X - 4)
    assert init(tmp_path, None).missing == ""
    config = load_rig_config(str(tmp_path / "rig.toml"))
    assert config.truth.own_frame
    assert config.prior.from_truth == []
    near = tmp_path / "near"
    near.mkdir()
    write(near, "tag.csv", time=TIME, x=X, y=Y)
    write(near, "mocap.csv", time=TIME, x=X + 0.1, y=Y)
    init(near, None)
    assert not load_rig_config(str(near / "rig.toml")).truth.own_frame


def test_what_is_there_is_not_written_over(log):
    init(log, None)
    before = (log / "rig.toml").read_bytes()
    with pytest.raises(DataError, match="is there already"):
        init(log, None)
    assert (log / "rig.toml").read_bytes() == before


def test_a_folder_of_which_nothing_is_understood(tmp_path):
    (tmp_path / "a.csv").write_text("colour,taste\nred,sweet\n")
    with pytest.raises(DataError, match=r"a\.csv: found no column of times; there are colour"):
        init(tmp_path, None)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    (tmp_path / "a.csv").write_text("0.0,1.5,-2\n0.1,1.6,-2\n")
    with pytest.raises(DataError, match=r"a\.csv: 1: found numbers, expected a line with"):
        init(tmp_path, None)


def test_a_bag_gets_a_rig_that_runs(tmp_path):
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        topics = {
            name: writer.register_channel(f"/{name}", "json", schema)
            for name in ("ground_truth", "odom", "amcl_pose", "imu", "chatter")
        }
        for at, rate, psi, x, y in zip(TIME, TURN, HEADING, X, Y, strict=True):
            time = round((at + 1.7e9) * 1e9)
            stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
            turn = {"x": 0.0, "y": 0.0, "z": np.sin(psi / 2), "w": np.cos(psi / 2)}
            twist = {"linear": {"x": 1.0}, "angular": {"z": rate}}
            here = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}
            covariance = np.diag([0.01, 0.01, 1.0, 1.0, 1.0, 0.02]).ravel().tolist()
            for name, content in {
                "ground_truth": {"pose": {"pose": here}, "twist": {"twist": twist}},
                "odom": {"pose": {"pose": here}, "twist": {"twist": twist}},
                "imu": {"orientation": turn},
                "amcl_pose": {"pose": {"pose": here, "covariance": covariance}},
                "chatter": {"data": "hello"},
            }.items():
                data = json.dumps({"header": {"stamp": stamp}, **content}).encode()
                writer.add_message(topics[name], log_time=time, publish_time=time, data=data)
        writer.finish()
    written, _, missing = init(path, tmp_path / "mine")
    assert [p.name for p in written] == ["rig.toml"]
    assert missing == ""
    config = load_rig_config(str(written[0]))
    assert config.vehicle.model == "unicycle"
    assert config.control.source == "odom"  # not the truth, which tells the same
    assert config.bag.truth == "ground_truth"
    assert "heading_bias" in config.vehicle.augmented  # nobody said where the IMU has its zero
    assert set(config.bag.topics["odom"].columns) == {"speed", "yaw_rate"}
    amcl = config.sensors["amcl_pose"]
    assert (amcl.model, amcl.covariance) == ("pose", ["xx", "xy", "xh", "yy", "yh", "hh"])
    assert "/chatter" in written[0].read_text()


def test_who_drives_in_the_plane():
    assert is_planar({"wheels": {"left", "right"}})
    assert not is_planar({"tag": {"range"}})


def test_a_rig_is_shown_whole_and_can_be_read_back(tmp_path):
    (tmp_path / "rig.toml").write_text('extends = "mrclam"\noutput.rate = 3.0\n')
    shown = show(str(tmp_path / "rig.toml"))
    (tmp_path / "shown.toml").write_text(shown)
    again = load_rig_config(str(tmp_path / "shown.toml"))
    assert again.output.rate == 3.0
    assert again.model_dump() == load_rig_config(str(tmp_path / "rig.toml")).model_dump()
