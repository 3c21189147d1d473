"""The Hanyang University outdoor UWB runs: a tag that walks away from four anchors, RTK truth.

A run is a folder: one table an anchor (``A3.csv`` and so on: stamp in ns, the anchor's place,
the range), and ``trajectory.csv`` (stamp in ns, x, y, z in m, heading in degrees).

The source is the description of the data set, DOI 10.5281/zenodo.15226105.
"""

import re
from pathlib import Path

import numpy as np

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import readers, unknown
from kedge.formats.cells import read_cells
from kedge.formats.logs import RawLog, TargetMap
from kedge.formats.tables import Table, build_table, in_order, table_of

PLACE = {"position_x": "field.x", "position_y": "field.y", "position_z": "field.z"}


@readers.add("hanyang_uwb")
def read_hanyang(path: Path, part: str | None = None) -> RawLog:
    """Read one run: its folder, or a folder above it and the way from there as ``part``.

    The anchors' places differ between the runs and are those that the files say.

    Raises:
        DataError: no run there, or a file in it cannot be used.
        UnknownName: no such run.
    """
    folder = _run(path, part)
    notes: list[str] = []
    files = sorted(folder.glob("A*.csv*"), key=_number)
    tables = [_anchor(file) for file in files if _number(file) >= 0]
    ids = [name for name, *_ in tables]
    stamps = np.concatenate([table.stamps for _, table, _ in tables])
    radio = table_of(
        "radio",
        folder,
        stamps,
        {"range": (np.concatenate([t.columns["range"] for _, t, _ in tables]), "m")},
        {"target": [name for name, table, _ in tables for _ in table.stamps]},
        np.concatenate([table.lines for _, table, _ in tables]),
    )
    radio = radio.take(np.argsort(radio.stamps, kind="stable"))
    places = np.array([place for *_, place in tables])
    anchors = TargetMap(
        tuple(ids), dict(zip(PLACE, places.T, strict=True)), dict.fromkeys(PLACE, "m")
    )
    truth, used = None, [table.path for _, table, _ in tables]
    if (file := _file(folder, "trajectory")) is not None:
        specs = {f"position_{axis}": (axis, "m") for axis in "xyz"}
        specs = {column: (name, unit) for name, (column, unit) in specs.items()}
        truth = in_order(
            build_table(read_cells(file), "truth", "timestamp", "ns", specs), notes
        )
        used.append(file)
    title = "/".join(folder.parts[-3:])
    return RawLog(
        title,
        {"radio": in_order(radio, notes)},
        truth,
        {"anchors": anchors},
        tuple(used),
        tuple(notes),
        "Unix",
    )


def _run(path: Path, part: str | None) -> Path:
    if not path.is_dir():
        raise DataError(f"{path}: no such folder, expected a run with A3.csv and so on")
    runs = {
        folder.relative_to(path).as_posix(): folder
        for folder in sorted({file.parent for file in path.rglob("A*.csv*")})
        if any(_number(file) >= 0 for file in folder.iterdir())
    }
    if part is not None:
        if part not in runs:
            raise UnknownName(f"{path}: {unknown('run', part, list(runs))}")
        return runs[part]
    if len(runs) != 1:
        choice = ", ".join(f"{path.name}#{name}" for name in runs) or "none"
        raise DataError(f"{path}: expected one run with A3.csv and so on; there are {choice}")
    return next(iter(runs.values()))


def _number(file: Path) -> int:
    match = re.fullmatch(r"A(\d+)\.csv(\.gz)?", file.name)
    return int(match[1]) if match else -1


def _file(folder: Path, stem: str) -> Path | None:
    names = (folder / f"{stem}.csv", folder / f"{stem}.csv.gz")
    return next((name for name in names if name.is_file()), None)


def _anchor(file: Path) -> tuple[str, Table, list[float]]:
    """Id, ranges and place of one anchor.

    Raises:
        DataError: the file says two places.
    """
    cells = read_cells(file)
    table = build_table(
        cells, "radio", "field.stamp", "ns", {"field.distanceFromTag": ("range", "m")}
    )
    place = []
    for column in PLACE.values():
        values = cells.numbers(column, "m")
        if (values != values[0]).any():
            at = int(np.argmax(values != values[0]))
            raise DataError(
                f"{file}:{cells.lines[at]}: column {column!r}: found {values[at]:g} after "
                f"{values[0]:g}, expected an anchor that stays"
            )
        place.append(float(values[0]))
    return str(_number(file)), table, place
