"""Whole small inputs of each reader, written here; damage is done to copies of them."""

import gzip
import importlib
import sys
from pathlib import Path

import numpy as np
from scipy.io import savemat

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS / "fixtures"), str(TESTS / "formats"), str(TESTS / "datasets")]


def write_all(folder: Path) -> dict[str, tuple[str, Path]]:
    """Format -> name of its reader, and what it reads: a file or a folder."""
    for name in ("csv", "navego", "mrclam", "akit", "hanyang", "starloc", "euroc", "trek"):
        (folder / name).mkdir(parents=True)
    for name in ("labyrinth", "lias", "tum"):
        (folder / name).mkdir()
    _csv(folder / "csv")
    _matlab(folder)
    _text(folder)
    _starloc(folder / "starloc")
    found = {
        "log folder": ("folder", folder / "csv"),
        "plaza (MATLAB)": ("plaza", folder / "plaza.mat"),
        "plaza (packed)": ("plaza", folder / "packed.mat"),
        "navego (MATLAB)": ("navego_synthetic", folder / "navego"),
        "trek1000": ("trek1000", folder / "trek"),
        "mrclam": ("mrclam", folder / "mrclam"),
        "akit": ("auv_akit_snapir", folder / "akit"),
        "hanyang": ("hanyang_uwb", folder / "hanyang"),
        "starloc": ("starloc", folder / "starloc" / "spiral_s5"),
        "labyrinth": ("labyrinth", folder / "labyrinth"),
        "lias": ("lias_trolley", folder / "lias"),
        "euroc": ("euroc_mh01_imu", folder / "euroc"),
    }
    found |= _receivers(folder)
    bags = importlib.import_module("test_bags")
    for kind in bags.KINDS:
        place = folder / kind.replace(" ", "_")
        place.mkdir()
        found[f"bag: {kind}"] = ("bag", bags.write(place, kind))
    return found


def bag_config():
    """What the bags' topics are."""
    return importlib.import_module("test_bags").config()


def _csv(folder: Path) -> None:
    texts = importlib.import_module("commands")
    (folder / "log.toml").write_text(texts.LOG)
    time = np.round(np.arange(0, 2, 0.1), 3)
    rows = {"odometry": "time,speed,yaw_rate", "truth": "time,position_x,position_y,heading"}
    for name, header in rows.items():
        width = header.count(",")
        lines = [",".join(map(str, [t, *np.linspace(0, t, width)])) for t in time]
        (folder / f"{name}.csv").write_text("\n".join([header, *lines]) + "\n")
    lines = [f"{t},{'ab'[k % 2]},{3 + t},0.1" for k, t in enumerate(time)]
    packed = gzip.compress("\n".join(["time,post,range,bearing", *lines]).encode())
    (folder / "camera.csv.gz").write_bytes(packed)


def _matlab(folder: Path) -> None:
    drive = importlib.import_module("test_range_sets").plaza(0.0)
    savemat(folder / "plaza.mat", drive)
    savemat(folder / "packed.mat", drive, do_compression=True)
    time = np.arange(6.0)[:, None]
    three, turns = np.ones((6, 3)), np.tile(np.eye(3).ravel(), (6, 1))
    place = {"t": time, "lat": time * 0.0 + 0.7, "lon": time * 1e-7, "h": time, "vel": three}
    for name, content in {
        "ref": place | {"DCMnb_m": turns, "kind": "truth"},
        "gnss": place | {"freq": 5.0},
        "imu1": {"t": time, "fb": three, "wb": three * 0.1},
    }.items():
        savemat(
            folder / "navego" / f"{name}.mat", {name: content}, do_compression=name == "ref"
        )
    trek = importlib.import_module("test_trek1000")
    (folder / "trek" / "output_range_uwb_4vnm.txt").write_text(trek.ROWS)
    poses = np.ones((4 * trek.EVERY, 10))
    poses[:, 1], poses[:, 2] = 1543489275, np.arange(len(poses)) * 1e6
    savemat(folder / "trek" / "4vNM.mat", {"posedata_uwb": poses}, do_compression=True)


def _text(folder: Path) -> None:
    akit, sets = (importlib.import_module(f"test_{name}") for name in ("akit", "range_sets"))
    for name, text in {
        "Barcodes": "# subject barcode\n 1 5\n 6 63\n",
        "Landmark_Groundtruth": "# a map\n 6 1.5 -2.5 0.001 0.002\n",
        "Robot1_Odometry": "# t v w\n10.001 0.1 0.2\n10.003 0.3 0.4\n10.002 0.5 0.6\n",
        "Robot1_Measurement": "10.002 63 2.0 -0.5\n10.004 99 3.0 0.1\n",
        "Robot1_Groundtruth": "10.000 0 0 0\n10.004 1 2 3\n",
    }.items():
        (folder / "mrclam" / f"{name}.dat").write_text(text)
    run = folder / "akit" / "Trajectory4"
    run.mkdir()
    rows = [f"{t}.0,2.0,0.1,-0.05\n" for t in range(4)]
    (run / "DVL_trajectory4.csv").write_text(akit.DVL + "".join(rows))
    rows = [f"{t}.0,{0.5 + 1e-7 * t},0,0,0,2,0,0.1,0.2,1.5\n" for t in range(4)]
    (run / "GT_trajectory4.csv").write_text(akit.GT + "".join(rows))
    (folder / "hanyang" / "A12.csv").write_text(sets.HANYANG + "9,2000,1,2,3,5.5\n")
    (folder / "hanyang" / "A3.csv").write_text(sets.HANYANG + "9,1000,4,5,6,7.5\n")
    (folder / "hanyang" / "trajectory.csv").write_text(
        "timestamp,x,y,z\n1e3,1,2,3\n2e3,1,2,3\n"
    )
    (folder / "labyrinth" / "A_Input.txt").write_text(sets.INPUT)
    (folder / "labyrinth" / "A_GT.txt").write_text("point2 1.0 3 4 0 0 0 0\n")
    sets.lias(folder / "lias", "exp_fast")
    imu = "".join(f"{1403636579758555392 + k * 5000000},0.1,0,0,9.8,0,0.1\n" for k in range(8))
    (folder / "euroc" / "imu0_data.csv").write_text("#timestamp [ns],wx,wy,wz,ax,ay,az\n" + imu)
    poses = "".join(f"1403636579.{76 + k} {k} 0 0 0 0 0 1\n" for k in range(8))
    (folder / "euroc" / "MH01_gt_tum.txt").write_text(poses)
    (folder / "tum" / "poses.tum").write_text("# poses\n" + poses)


def _receivers(folder: Path) -> dict[str, tuple[str, Path]]:
    """A few fixes as NMEA, u-blox and GPX, by the tests' own writers."""
    geodetic, ublox = (importlib.import_module(f"test_{n}") for n in ("geodetic", "ublox"))
    course = "4800.0,N,00900.0,E,10.0,090.0,311223,,,A"
    lines = [geodetic.sentence(f"GPRMC,120000.00,A,{course}")]
    lines += [geodetic.gga(f"1200{k:02d}.00", k / 10) for k in range(6)]
    points = (geodetic.POINT.format(48 + k, f"2024-01-01T00:00:0{k}Z") for k in range(6))
    contents = {
        "nmea": "\r\n".join(lines).encode(),
        "ublox": b"".join(ublox.solution(k, 48 + k / 1000) for k in range(6)),
        "gpx": geodetic.GPX.format("".join(points)).encode(),
    }
    for name, data in contents.items():
        (folder / f"drive.{name}").write_bytes(data)
    return {name: (name, folder / f"drive.{name}") for name in contents}


def _starloc(folder: Path) -> None:
    spiral = folder / "spiral_s5"
    spiral.mkdir()
    time = np.arange(0, 8, 0.05)
    where = np.stack([np.cos(time), 2 * np.sin(0.7 * time), 0.05 * time], axis=1)
    true = np.linalg.norm(where - [3, -1, 2], axis=1)
    ones = np.ones_like(time)
    turn = np.outer(ones, [1, 0, 0, 0])
    columns = [time, true + 0.2, ones, 9 * ones, where, turn, where, true]
    head = "time_s range from_id to_id x y z w rot_x rot_y rot_z tag_pos_x tag_pos_y tag_pos_z"
    _table(spiral / "uwb.csv", f"{head} gt_range", np.column_stack(columns))
    names = [f"{w}_{a}" for w in ("linear_acceleration", "angular_velocity") for a in "xyz"]
    rows = np.column_stack([time, np.tile(np.arange(6.0), (len(time), 1)), where])
    _table(spiral / "imu.csv", " ".join(["time_s", *names, "x", "y", "z"]), rows)


def _table(path: Path, head: str, rows: np.ndarray) -> None:
    np.savetxt(
        path, rows, fmt="%.9g", delimiter=",", header=",".join(head.split()), comments=""
    )
