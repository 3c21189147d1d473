"""The "Labyrinth" set: a small robot on two wheels among UWB modules, in libRSF's text format.

A line is a kind and its numbers: ``range2`` (time, range, variance, module x, y, id, snr),
``odom2diff`` (time, two wheel speeds, sideways speed, wheel distance, variances), ``point2``
(time, x, y, covariance).

The readme calls the first wheel the right one and 0.0785 m the distance between the wheels.
Read like that, dead reckoning turns the wrong way and twice as far; with the first wheel left
and that distance from the middle to a wheel, it follows the truth to some centimetres. So they
are read.

Source: T. Pfeifer, P. Protzel, "Expectation-maximization for adaptive mixture models in graph
optimization", ICRA 2019 (the set, published with libRSF).
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.core.registry import readers
from kedge.formats.cells import Cells
from kedge.formats.logs import RawLog, TargetMap
from kedge.formats.tables import build_table, in_order
from kedge.formats.text import read_text

KINDS = {
    "range2": ("time", "range", "variance", "x", "y", "target", "snr"),
    "odom2diff": ("time", "left", "right", "side", "arm", "vl", "vr", "vy"),
    "point2": ("time", "position_x", "position_y", "cxx", "cxy", "cyx", "cyy"),
}
"""Kind of line -> its columns."""


@readers.add("labyrinth")
def read_labyrinth(path: Path, part: str | None = None) -> RawLog:
    """Read a folder with ``..._Input.txt`` and, for scores, ``..._GT.txt``; or such a file.

    Raises:
        DataError: no such files, or a line cannot be used.
    """
    if part is not None:
        raise DataError(f"{path}: found part {part!r}, but a folder holds one drive")
    source = _one(path, "Input")
    if source is None:
        raise DataError(f"{path}: no file ..._Input.txt, expected one")
    notes: list[str] = []
    lines = _lines(source)
    ranges, wheels = (_cells(source, lines, kind) for kind in ("range2", "odom2diff"))
    others = sorted({kind for _, kind, _ in lines} - set(KINDS))
    if others:
        notes.append(f"{source.name}: lines of kind {', '.join(others)} were left out")

    radio = build_table(
        ranges, "radio", "time", "s", {"range": ("range", "m"), "std": ("std", "m")}, "target"
    )
    specs = {"left": ("left", "m/s"), "right": ("right", "m/s")}
    odometry = build_table(wheels, "odometry", "time", "s", specs)
    truth, files = None, [source]
    known = _one(source.with_name(source.name.replace("_Input", "_GT")), "GT")
    if known is not None:
        cells = _cells(known, _lines(known), "point2")
        places = {axis: (axis, "m") for axis in ("position_x", "position_y")}
        truth = in_order(build_table(cells, "truth", "time", "s", places), notes)
        files.append(known)
    tables = {"odometry": in_order(odometry, notes), "radio": in_order(radio, notes)}
    return RawLog(
        source.name.replace("_Input", "").removesuffix(".gz").removesuffix(".txt"),
        tables,
        truth,
        {"modules": _modules(ranges)},
        tuple(files),
        tuple(notes),
    )


def _one(path: Path, kind: str) -> Path | None:
    """The file itself, or the only one of its kind in the folder."""
    if path.is_file():
        return path
    files = sorted(path.glob(f"*_{kind}.txt*")) if path.is_dir() else []
    return files[0] if len(files) == 1 else None


def _lines(path: Path) -> list[tuple[int, str, list[str]]]:
    """Number, kind and cells of each line."""
    rows = ((n, row.split()) for n, row in enumerate(read_text(path).splitlines(), start=1))
    return [(number, row[0], row[1:]) for number, row in rows if row]


def _cells(path: Path, lines: list[tuple[int, str, list[str]]], kind: str) -> Cells:
    chosen = [(number, cells) for number, table, cells in lines if table == kind]
    if not chosen:
        raise DataError(f"{path}: found no line of kind {kind!r}, expected some")
    for number, cells in chosen:
        if len(cells) != len(KINDS[kind]):
            raise DataError(
                f"{path}:{number}: found {len(cells)} cells after {kind!r}, expected "
                f"{len(KINDS[kind])}: {', '.join(KINDS[kind])}"
            )
    columns = zip(KINDS[kind], zip(*(cells for _, cells in chosen), strict=True), strict=True)
    table = Cells(
        path, {name: list(cells) for name, cells in columns}, np.array([n for n, _ in chosen])
    )
    if kind == "range2":
        std = _root(table, "variance")
        table.columns["std"] = [repr(value) for value in std.tolist()]
    return table


def _root(cells: Cells, column: str) -> Float[np.ndarray, " n"]:
    values = cells.numbers(column)
    if not (values > 0).all():
        at = int(np.argmin(values > 0))
        raise DataError(
            f"{cells.path}:{cells.lines[at]}: column {column!r}: found {values[at]:g}, "
            "expected a variance above 0"
        )
    return np.sqrt(values)


def _modules(ranges: Cells) -> TargetMap:
    """Each module's place, which stands in every line of its ranges."""
    x, y, names = ranges.numbers("x"), ranges.numbers("y"), ranges.text("target")
    first = {name: at for at, name in reversed(list(enumerate(names)))}
    ids = tuple(sorted(first))
    shifted = [i for i, n in enumerate(names) if (x[i], y[i]) != (x[first[n]], y[first[n]])]
    if shifted:
        raise DataError(
            f"{ranges.path}:{ranges.lines[shifted[0]]}: module {names[shifted[0]]!r} stands "
            "elsewhere than in its first line, expected modules that stay"
        )
    rows = [first[name] for name in ids]
    units = {"position_x": "m", "position_y": "m"}
    return TargetMap(ids, {"position_x": x[rows], "position_y": y[rows]}, units)
