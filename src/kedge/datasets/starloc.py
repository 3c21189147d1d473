"""STAR-loc: a hand-held rig with two UWB tags and an IMU among anchors, Vicon truth.

A sequence is a folder ``NAME_SETUP`` with ``uwb.csv`` and ``imu.csv``. Three things of it are
mended here. The clocks of the two files differ: they are matched by the true positions, which
both carry. The IMU's axes are not the rig's: its readings are turned by what is known of the
setup. And the published list of anchors is permuted against the ids in some setups: the anchors
are found from the true ranges, which each row of ``uwb.csv`` carries.

Source: F. Dümbgen, M. Shalaby, C. Holmes, C. Cossette, J. Forbes, J. Le Ny, T. Barfoot,
"STAR-loc: dataset for stereo and range-based localization", arXiv 2309.05518, 2023.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from kedge.core.errors import DataError
from kedge.core.registry import readers
from kedge.estimation.log import SECOND
from kedge.formats.cells import Cells, read_cells
from kedge.formats.logs import RawLog, TargetMap
from kedge.formats.tables import Table, build_table, in_order, table_of

PLACE = ("x", "y", "z")
QUATERNION = ("w", "rot_x", "rot_y", "rot_z")
IMU = {
    "specific_force": ("linear_acceleration", "m/s^2"),
    "angular_rate": ("angular_velocity", "rad/s"),
}
RIG_FROM_IMU = {
    "s1": (-179.4, 0.5, -13.5),
    "s2": (-179.4, 0.5, -13.5),
    "s5": (177.7, 0.9, -0.9),
}
"""Setup -> rotation vector, in degrees, fitted between gyroscope and true rates; the set's own
calibration speaks of another frame."""
GLITCH = 0.05  # m from the median of the neighbours, which no hand does in 50 ms


@readers.add("starloc")
def read_starloc(path: Path, part: str | None = None) -> RawLog:
    """Read one sequence.

    Raises:
        DataError: a file is missing, or a cell in it cannot be used.
    """
    if part is not None:
        raise DataError(f"{path}: found part {part!r}, but a folder holds one sequence")
    ranges = read_cells(_file(path, "uwb"))
    notes: list[str] = []
    tables = {
        f"tag_{tag}": in_order(table, notes) for tag, table in _tags(ranges).items() if table
    }
    truth, files = _truth(ranges, notes), [ranges.path]
    setup = path.resolve().name.rpartition("_")[2]
    if setup in RIG_FROM_IMU:
        inertial = read_cells(_file(path, "imu"))
        files.append(inertial.path)
        tables["imu"] = in_order(_imu(inertial, truth, setup, notes), notes)
    else:
        notes.append(f"imu: how it is turned in setup {setup!r} is not known; left out")
    return RawLog(
        path.resolve().name,
        tables,
        truth,
        {"anchors": _anchors(ranges)},
        tuple(files),
        tuple(notes),
        "first Vicon reading",
    )


def _file(folder: Path, stem: str) -> Path:
    names = (folder / f"{stem}.csv", folder / f"{stem}.csv.gz")
    file = next((name for name in names if name.is_file()), None)
    if file is None:
        raise DataError(f"{folder / stem}.csv: no such file, packed or not")
    return file


def _columns(cells: Cells, names: tuple[str, ...]) -> Float[np.ndarray, "n k"]:
    return np.stack([cells.complete(name) for name in names], axis=1)


def _tags(cells: Cells) -> dict[str, Table]:
    """A table of ranges by tag."""
    table = build_table(cells, "radio", "time_s", "s", {"range": ("range", "m")})
    tags, anchors = np.array(cells.identifiers("from_id")), cells.identifiers("to_id")
    table = table._replace(texts={"target": anchors})
    return {
        tag: table.take(np.flatnonzero(tags == tag))._replace(name=f"tag_{tag}")
        for tag in sorted(set(tags.tolist()))
    }


def _anchors(cells: Cells) -> TargetMap:
    """Each anchor where the true ranges from the true places of the tags put it.

    $2 p^T a - |a|^2 = |p|^2 - d^2$ is linear in the anchor and the square of its distance.
    """
    tags = _columns(cells, tuple(f"tag_pos_{axis}" for axis in PLACE))
    true, names = cells.complete("gt_range"), np.array(cells.identifiers("to_id"))
    ids, places = sorted(set(names.tolist()), key=int), []
    for anchor in ids:
        mine = names == anchor
        rows = np.hstack([2 * tags[mine], -np.ones((mine.sum(), 1))])
        sides = (tags[mine] ** 2).sum(axis=1) - true[mine] ** 2
        solution, rank = np.zeros(len(PLACE) + 1), 0
        if np.isfinite(sides).all():  # squares of finite numbers may not be
            solution, _, rank, _ = np.linalg.lstsq(rows, sides, rcond=None)
        if rank < 4:
            raise DataError(
                f"{cells.path}: anchor {anchor}: {mine.sum()} true ranges do not fix its place"
            )
        places.append(solution[:3])
    columns = {f"position_{axis}": np.array(places)[:, i] for i, axis in enumerate(PLACE)}
    return TargetMap(tuple(ids), columns, dict.fromkeys(columns, "m"))


def _truth(cells: Cells, notes: list[str]) -> Table:
    """The rig's poses, without the moments at which Vicon mistook its markers."""
    columns = {f"position_{axis}": (axis, "m") for axis in PLACE}
    columns |= {f"attitude_{a}": (n, "1") for a, n in zip("wxyz", QUATERNION, strict=True)}
    specs = {name: (inside, unit) for inside, (name, unit) in columns.items()}
    table = in_order(build_table(cells, "truth", "time_s", "s", specs), notes)
    place = np.stack([table.columns[f"position_{axis}"] for axis in PLACE], axis=1)
    good = ~_glitches(place)
    if not good.all():
        notes.append(f"truth: {int((~good).sum())} poses that jump were left out")
    return table.take(np.flatnonzero(good))


def _glitches(place: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which positions are off the median of their eleven neighbours."""
    padded = np.pad(place, ((5, 5), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 11, axis=0)
    return np.linalg.norm(place - np.median(windows, axis=-1), axis=1) > GLITCH


def _imu(cells: Cells, truth: Table, setup: str, notes: list[str]) -> Table:
    """Specific force and angular rate in the rig's axes and by the clock of the ranges."""
    time = cells.stamps("time_s") / SECOND
    shift = _shift(time, _columns(cells, PLACE), truth)
    notes.append(f"imu: its clock was set back by {shift:.3f} s")
    turn = Rotation.from_rotvec(RIG_FROM_IMU[setup], degrees=True)
    columns = {}
    for field, (name, unit) in IMU.items():
        values = turn.apply(_columns(cells, tuple(f"{name}_{axis}" for axis in PLACE)))
        columns |= {f"{field}_{axis}": (values[:, i], unit) for i, axis in enumerate(PLACE)}
    stamps = np.round((time - shift) * SECOND).astype(np.int64)
    return table_of("imu", cells.path, stamps, columns, None, cells.lines)


def _shift(
    time: Float[np.ndarray, " n"], place: Float[np.ndarray, "n 3"], truth: Table
) -> float:
    """By how much one clock is ahead, from the same positions told by both."""
    known = np.stack([truth.columns[f"position_{axis}"] for axis in PLACE], axis=1)
    clock = truth.stamps / SECOND

    def gap(shift: float) -> float:
        then = time - shift
        inside = (then > clock[0]) & (then < clock[-1])
        if inside.sum() < 100:
            return np.inf
        at = np.stack([np.interp(then[inside], clock, column) for column in known.T], axis=1)
        return float(np.median(np.linalg.norm(at - place[inside], axis=1)))

    middle, step = 0.0, 0.05
    for reach in (60, 20, 20):
        middle += step * min(range(-reach, reach + 1), key=lambda k: gap(middle + step * k))
        step /= 10
    return middle
