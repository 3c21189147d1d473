"""The UTIAS multi-robot data sets (MRCLAM): wheel commands, a camera and Vicon truth.

The camera names barcodes; here they become subjects (1 to 5 are robots, 6 to 20 landmarks). A
barcode that no subject wears was misread and stays as ``barcode:NN``, which is on no map.

Source: K. Leung, Y. Halpern, T. Barfoot, H. Liu, "The UTIAS multi-robot cooperative
localization and mapping dataset", IJRR 30(8), 2011.
"""

import re
from collections import Counter
from pathlib import Path

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import readers, unknown
from kedge.formats.cells import Cells, read_cells
from kedge.formats.logs import RawLog, TargetMap
from kedge.formats.tables import build_table, in_order

SOURCES = {
    "odometry": ("Odometry", {"speed": "m/s", "yaw_rate": "rad/s"}),
    "camera": ("Measurement", {"range": "m", "bearing": "rad"}),
    "truth": (
        "Groundtruth",
        {"position_x": "m", "position_y": "m", "heading": "rad"},
    ),
}
"""Source -> name of its file, units of its columns."""
MAP = {"position_x": "m", "position_y": "m", "position_x_std": "m", "position_y_std": "m"}


@readers.add("mrclam")
def read_mrclam(path: Path, part: str | None = None) -> RawLog:
    """Read one robot of a data set, or of a folder that holds exactly one data set.

    Rows out of order are sorted, and of several rows with one stamp (and target) the last is
    kept, since a later command replaces the earlier; ``notes`` says how many there were.

    Args:
        path: a folder with Barcodes.dat, RobotN_Odometry.dat and so on, packed or not.
        part: the number of the robot; not needed if there is only one.

    Raises:
        DataError: no such data set, or a file in it cannot be used.
        UnknownName: no such robot.
    """
    folder = _data_set(path)
    robot = _robot(folder, part)
    notes: list[str] = []

    barcodes = read_cells(_file(folder, "Barcodes"), ("subject", "barcode"))
    subjects = dict(
        zip(barcodes.identifiers("barcode"), barcodes.identifiers("subject"), strict=True)
    )
    landmarks = read_cells(_file(folder, "Landmark_Groundtruth"), ("subject", *MAP))
    columns = {name: landmarks.numbers(name, unit) for name, unit in MAP.items()}
    targets = TargetMap(tuple(landmarks.text("subject")), columns, dict(MAP))

    tables = {}
    for name, (stem, units) in SOURCES.items():
        target = "target" if name == "camera" else None
        file = _file(folder, f"Robot{robot}_{stem}")
        cells = read_cells(file, ("time", *([target] if target else []), *units))
        if target:
            cells = _named(cells, subjects, notes)
        specs = {column: (column, unit) for column, unit in units.items()}
        table = build_table(cells, name, "time", "s", specs, target)
        tables[name] = in_order(table, notes)
    truth = tables.pop("truth")
    files = (barcodes.path, landmarks.path, *(t.path for t in (*tables.values(), truth)))
    title = f"{folder.name}, robot {robot}"
    return RawLog(title, tables, truth, {"landmarks": targets}, files, tuple(notes), "Unix")


def _named(cells: Cells, subjects: dict[str, str], notes: list[str]) -> Cells:
    codes = cells.identifiers("target")
    strange = Counter(code for code in codes if code not in subjects)
    for code, count in sorted(strange.items()):
        notes.append(f"camera: {count} readings of barcode {code}, which no subject wears")
    names = [subjects.get(code, f"barcode:{code}") for code in codes]
    return cells._replace(columns={**cells.columns, "target": names})


def _data_set(path: Path) -> Path:
    if not path.is_dir():
        raise DataError(f"{path}: no such folder, expected an MRCLAM data set")
    holding = [
        f for f in (path, *sorted(path.iterdir())) if f.is_dir() and _found(f, "Barcodes")
    ]
    if path in holding:
        return path
    if len(holding) != 1:
        names = ", ".join(folder.name for folder in holding) or "none"
        raise DataError(
            f"{path}: expected Barcodes.dat here or in exactly one folder below; found it in "
            f"{names}"
        )
    return holding[0]


def _robot(folder: Path, part: str | None) -> str:
    names = (re.fullmatch(r"Robot(\d+)_Odometry\.dat(\.gz)?", f.name) for f in folder.iterdir())
    robots = sorted({match[1] for match in names if match}, key=int)
    if part is None and len(robots) == 1:
        return robots[0]
    if part is None:
        choice = ", ".join(f"{folder.name}#{robot}" for robot in robots) or "none"
        raise DataError(
            f"{folder}: expected a robot's number after the path; there are {choice}"
        )
    if part not in robots:
        raise UnknownName(f"{folder}: {unknown('robot', part, robots)}")
    return part


def _found(folder: Path, stem: str) -> Path | None:
    names = (folder / f"{stem}.dat", folder / f"{stem}.dat.gz")
    return next((path for path in names if path.is_file()), None)


def _file(folder: Path, stem: str) -> Path:
    path = _found(folder, stem)
    if path is None:
        raise DataError(f"{folder / stem}.dat: no such file, packed or not")
    return path
