"""The planar trolley of LIAS-CUHKSZ: three tags, eight anchors, 100 Hz, motion capture.

The file of ranges has no header: wall-clock time, then a0-t0, a0-t1, a0-t2, a1-t0, ... in m.
The file of poses has one: time, x, y, z and a quaternion (w, x, y, z) of a body that is upside
down.

Source: H. Jiang, W. Wang, Y. Shen, X. Li, X. Ren, B. Mu, J. Wu, "Efficient planar pose
estimation via UWB measurements", ICRA 2023.
"""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import readers, unknown
from kedge.formats.cells import Cells
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table, in_order, table_of
from kedge.formats.text import read_text
from kedge.formats.times import since_1970

TAGS = 3
SURVEYED = 1 / 3
"""Share of the drive for which the poses are a source, ``survey``, to calibrate with."""
PREFIXES = "UWB_", "motion_capture_"


@readers.add("lias_trolley")
def read_lias(path: Path, part: str | None = None) -> RawLog:
    """Read a folder, or the file of ranges in it; ``part`` tells several drives apart.

    The tags' tables are ``tag_0`` to ``tag_2``, each reading with its anchor (``a0`` and so
    on). The poses of the first third are the table ``survey``; the truth is what comes after
    them, so that no error is scored that a calibration has seen.

    Raises:
        DataError: a file is missing, or a line cannot be used.
        UnknownName: no such drive.
    """
    source = _ranges(path, part)
    drive = source.name.removeprefix(PREFIXES[0])
    poses = source.with_name(PREFIXES[1] + drive)
    notes: list[str] = []
    stamps, values = _numbers(source, 25, header=False)
    tables = {f"tag_{tag}": _tag(source, stamps, values, tag, notes) for tag in range(TAGS)}
    files, truth = [source], None
    if poses.is_file():
        files.append(poses)
        known = in_order(_poses(poses), notes)
        last = stamps[0] + round((stamps[-1] - stamps[0]) * SURVEYED)
        early = known.stamps <= last
        tables["survey"] = known.take(np.flatnonzero(early))._replace(name="survey")
        truth = known.take(np.flatnonzero(~early))
        notes.append(
            f"survey: the poses of the first {(last - stamps[0]) / 1e9:.1f} s are there to "
            "calibrate with; errors are scored after it"
        )
    title = drive.removesuffix(".gz").removesuffix(".csv")
    return RawLog(title, tables, truth, {}, tuple(files), tuple(notes), "wall clock")


def _ranges(path: Path, part: str | None) -> Path:
    if path.is_file():
        return path
    drives = {
        file.name.removeprefix(PREFIXES[0]).split(".")[0]: file
        for file in (sorted(path.glob(f"{PREFIXES[0]}*.csv*")) if path.is_dir() else [])
    }
    if part is None and len(drives) == 1:
        return next(iter(drives.values()))
    if part is None:
        choice = ", ".join(f"{path.name}#{name}" for name in drives) or "none"
        raise DataError(f"{path}: expected one {PREFIXES[0]}....csv; there are {choice}")
    if part not in drives:
        raise UnknownName(f"{path}: {unknown('drive', part, list(drives))}")
    return drives[part]


def _tag(
    path: Path,
    stamps: Int64[np.ndarray, " n"],
    values: Float[np.ndarray, "n k"],
    tag: int,
    notes: list[str],
) -> Table:
    mine = values[:, tag::TAGS]
    rows, anchors = mine.shape
    table = table_of(
        f"tag_{tag}",
        path,
        np.repeat(stamps, anchors),
        {"range": (mine.ravel(), "m")},
        {"target": [f"a{anchor}" for anchor in range(anchors)] * rows},
        np.repeat(np.arange(1, rows + 1), anchors),
    )
    return in_order(table, notes)


def _poses(path: Path) -> Table:
    stamps, values = _numbers(path, 8, header=True)
    # Upside down: half a turn about an axis in the plane, which the quaternion's x and y tell.
    heading = 2 * np.arctan2(values[:, 5], values[:, 4])
    columns = {"position_x": values[:, 0], "position_y": values[:, 1]}
    units = {name: (column, "m") for name, column in columns.items()}
    return table_of("truth", path, stamps, units | {"heading": (heading, "rad")})


def _numbers(
    path: Path, count: int, header: bool
) -> tuple[Int64[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
    """Stamps and numbers of a CSV file whose first column is a wall-clock time."""
    rows = [line.split(",") for line in read_text(path).splitlines() if line.strip()]
    rows = rows[1:] if header else rows
    first = 2 if header else 1
    for line, row in enumerate(rows, start=first):
        if len(row) != count:
            raise DataError(f"{path}:{line}: found {len(row)} cells, expected {count}")
    if not rows:
        raise DataError(f"{path}: empty log: found no rows, expected at least one")
    names = ["time", *map(str, range(1, count))]
    columns = zip(names, zip(*rows, strict=True), strict=True)
    cells = Cells(
        path,
        {name: list(column) for name, column in columns},
        np.arange(first, first + len(rows)),
    )
    stamps = [_stamp(path, first + at, text) for at, text in enumerate(cells.text("time"))]
    values = np.stack([cells.numbers(name) for name in names[1:]], axis=1)
    return np.array(stamps, np.int64), values


def _stamp(path: Path, line: int, text: str) -> int:
    """A wall-clock time in ns, as if it were UTC: the zone is not written down."""
    try:
        moment = datetime.strptime(text, "%Y-%m-%d %H:%M:%S.%f").replace(tzinfo=UTC)
    except ValueError:
        raise DataError(
            f"{path}:{line}: found {text!r}, expected a time such as 2022-08-15 9:42:24.766"
        ) from None
    return since_1970(moment)
