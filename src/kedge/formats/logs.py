"""Log folders: one CSV file a source, and a ``log.toml`` that declares them.

What the declaration says of a source: the file, the columns of time, target and measurements
with their units, and the frame: ``enu`` or ``ned``, see :mod:`kedge.formats.units`.
"""

import csv
import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from kedge.core.errors import DataError
from kedge.core.registry import readers, unknown
from kedge.formats.attitudes import all_to_enu
from kedge.formats.bag_frames import Placed
from kedge.formats.cells import read_cells
from kedge.formats.log_config import Frame, LogConfig, MapSource, SourceConfig
from kedge.formats.origin import with_status
from kedge.formats.results_folder import fresh_folder
from kedge.formats.tables import (
    Column,
    Table,
    build_table,
    check_order,
    require_finite,
    sorted_rows,
)
from kedge.formats.times import TimeForm
from kedge.formats.toml import quoted, read_toml
from kedge.formats.units import is_covariance, unit_of

T = TypeVar("T")


class TargetMap(NamedTuple):
    """Targets that readings name: landmarks, beacons, anchors."""

    ids: tuple[str, ...]
    columns: dict[str, np.ndarray]
    """In SI units and ENU, by component: ``position_x``."""
    units: dict[str, str] = {}
    """SI unit of each column."""


class RawLog(NamedTuple):
    """A log as it was recorded, in SI units and ENU."""

    title: str
    tables: dict[str, Table]
    truth: Table | None = None
    """Its columns are called like the components of the state."""
    maps: dict[str, TargetMap] = {}
    files: tuple[Path, ...] = ()
    """What was read."""
    notes: tuple[str, ...] = ()
    """What the reader changed, for the user to see."""
    epoch: str = ""
    """What stamp 0 means."""
    place: dict[str, float] = {}
    """Where it was taken: ``latitude`` (rad) and ``height`` (m) of the map's origin, for
    vehicles that ask for them."""
    mounts: dict[str, Placed] = {}
    """By source, where on the body it was recorded, if the log tells."""


@readers.add("folder")
def read_folder(folder: Path, part: str | None = None) -> RawLog:
    """Read a log folder.

    Raises:
        DataError: with file, line and key or column; a mistaken ``log.toml`` gives one line for
            each mistake.
    """
    if part is not None:
        raise DataError(
            f"{folder}: found part {part!r}, expected none: a log folder has no parts"
        )
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder, expected a log folder with a log.toml")
    config = read_toml(folder / "log.toml", LogConfig, error=DataError)
    if not config.sources and not config.files:
        raise DataError(f"{folder / 'log.toml'}: sources: empty log: there are none")
    tables: dict[str, Table] = {}
    maps: dict[str, TargetMap] = {}
    files = [folder / "log.toml"]
    notes: list[str] = []
    for name, source in config.sources.items():
        frame = source.frame or config.frame
        tables[name] = _read_source(folder, name, source, frame, notes)
        files.append(tables[name].path)
    for name, spec in config.maps.items():
        path = _file(folder, spec.file) if spec.file else files[0]
        maps[name] = _read_map(path, spec, spec.frame or config.frame)
        files.append(path)
    for name, format in config.files.items():
        other = readers.get(format)(folder / name, None)
        _add(folder, name, tables, other.tables, "source")
        _add(folder, name, maps, other.maps, "map")
        files += other.files
        notes += other.notes
        notes += [f"{name}: its time 0 is {other.epoch}"] * (other.epoch not in ("", "Unix"))
    if config.truth and config.truth not in tables:
        what = unknown("source", config.truth, list(tables))
        raise DataError(f"{folder / 'log.toml'}: truth: {what}")
    truth = tables.pop(config.truth) if config.truth else None
    if truth is not None:
        require_finite(truth, truth.columns, "truth")
    place = {} if config.origin == "first" else config.origin.place
    read = tuple(dict.fromkeys(files))
    return RawLog(config.title, tables, truth, maps, read, tuple(notes), config.epoch, place)


def write_log(folder: Path, raw: RawLog) -> None:
    """Write a log folder that reads back bit for bit: whole, or not at all.

    Raises:
        DataError: the folder is not empty, cannot be written, or a name is no file name.
    """
    tables = {**raw.tables, **({raw.truth.name: raw.truth} if raw.truth else {})}
    if len(tables) == len(raw.tables) and raw.truth:
        raise DataError(f"{folder}: truth and a source are both called {raw.truth.name!r}")
    lines = [f"title = {quoted(raw.title)}", f"epoch = {quoted(raw.epoch)}"]
    lines += [f"truth = {quoted(raw.truth.name)}"] if raw.truth else []
    with fresh_folder(folder) as draft:
        for name, table in tables.items():
            file = _file_name(folder, name)
            if table.ned:
                raise DataError(
                    f"{folder}: {name}: found covariances of frame 'ned', expected 'enu'"
                )
            body = [f"file = {quoted(file)}", 'time = "time"', 'time_unit = "ns"']
            body += [f"target = {quoted(text)}" for text in table.texts]
            infinite = any(np.isinf(values).any() for values in table.columns.values())
            body += ['not_finite = "reject"'] if infinite else []
            body.append(f"columns = {_units(table.columns, table.units)}")
            lines += ["", f"[sources.{quoted(name)}]", *body]
            stamps = {"time": map(str, table.stamps.tolist())}
            _write_csv(draft / file, stamps | table.texts, table.columns)
        for name, targets in raw.maps.items():
            file = _file_name(folder, f"map_{name}")
            lines += ["", f"[maps.{quoted(name)}]", f"file = {quoted(file)}", 'id = "id"']
            lines.append(f"columns = {_units(targets.columns, targets.units)}")
            _write_csv(draft / file, {"id": targets.ids}, targets.columns)
        (draft / "log.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def digest_inputs(raw: RawLog) -> str:
    """SHA-256 over name, length and bytes of every file read, in the order of their names."""
    digest = hashlib.sha256()
    for path in sorted(raw.files, key=lambda path: (path.name, path)):
        data = path.read_bytes()
        digest.update(f"{path.name}\0{len(data)}\0".encode() + data)
    return digest.hexdigest()


def _add(
    folder: Path, file: str, known: dict[str, T], others: Mapping[str, T], kind: str
) -> None:
    """Put what another format brings to what ``log.toml`` says.

    Raises:
        DataError: both have one of the same name.
    """
    if twice := sorted(known.keys() & others.keys()):
        raise DataError(
            f"{folder / 'log.toml'}: files.{file}: found a {kind} {twice[0]!r} that there is "
            "already, expected other names"
        )
    known.update(others)


def _read_source(
    folder: Path, name: str, source: SourceConfig, frame: Frame, notes: list[str]
) -> Table:
    specs = {
        column: Column(spec.name or column, spec.unit, tuple(spec.missing))
        for column, spec in source.columns.items()
    }
    turned = source.attitude
    if turned is not None:
        specs |= {
            column: Column(column, unit) for column, unit in turned.column_units().items()
        }
    form = TimeForm(source.time_unit, source.date, source.week)
    cells = read_cells(_file(folder, source.file or f"{name}.csv"), notes=notes)
    table = build_table(
        cells, name, source.time, form, specs, source.target, source.not_finite, notes
    )
    table = with_status(table, cells)
    if source.order == "sort":
        table = sorted_rows(table, source.time, notes)
    else:
        check_order(table, source.time, '; order = "sort" in log.toml puts it in order')
    if turned is not None:
        others = {c: v for c, v in table.columns.items() if c not in turned.columns}
        attitude = turned.inside(table.columns)
        units = {c: table.units[c] for c in others} | dict.fromkeys(attitude, "1")
        table = table._replace(columns=others | attitude, units=units)
    if frame == "ned":
        columns, units = all_to_enu(table.path, table.columns, table.units)
        ned = frozenset(column for column, unit in units.items() if is_covariance(unit))
        table = table._replace(columns=columns, units=units, ned=ned)
    return table


def _read_map(path: Path, spec: MapSource, frame: Frame) -> TargetMap:
    columns, units = {}, {}
    cells = read_cells(path) if spec.file else None
    ids = cells.text(spec.id) if cells else list(spec.ids or ())
    for column, (name, unit) in ((c, (s.name or c, s.unit)) for c, s in spec.columns.items()):
        factor = unit_of(unit)[1]
        columns[name] = (
            cells.numbers(column, unit) if cells else np.array(spec.values[column]) * factor
        )
        units[name] = unit_of(unit)[0]
    if frame == "ned":
        if products := [column for column, unit in units.items() if is_covariance(unit)]:
            raise DataError(
                f"{path}: column {products[0]!r}: a map's covariance cannot be converted from "
                "frame 'ned'; write it in 'enu'"
            )
        columns, units = all_to_enu(path, columns, units)
    return checked_map(f"{path}", ids, columns, units)


def checked_map(
    place: str, ids: Sequence[str], columns: dict[str, np.ndarray], units: dict[str, str]
) -> TargetMap:
    """A map of targets.

    Raises:
        DataError: it has no target, one twice, or one without a finite place.
    """
    if not ids:
        raise DataError(f"{place}: found a map without targets, expected at least one")
    if twice := [name for name, count in Counter(ids).items() if count > 1]:
        raise DataError(f"{place}: found target {twice[0]!r} twice, expected each once")
    for column, values in columns.items():
        if not np.isfinite(values).all():
            name = ids[int(np.argmin(np.isfinite(values)))]
            raise DataError(
                f"{place}: column {column!r}: target {name!r}: expected a finite number"
            )
    return TargetMap(tuple(ids), columns, units)


def _file(folder: Path, name: str) -> Path:
    """The file, or its packed twin."""
    packed = folder / f"{name}.gz"
    return packed if packed.is_file() and not (folder / name).exists() else folder / name


def _write_csv(
    path: Path, texts: Mapping[str, Iterable[str]], columns: Mapping[str, np.ndarray]
) -> None:
    # repr is the shortest text that reads back as the same float.
    numbers = (
        ["" if value != value else repr(value) for value in values.tolist()]
        for values in columns.values()
    )
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*texts, *columns])
        writer.writerows(zip(*texts.values(), *numbers, strict=True))


def _units(columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> str:
    pairs = (f"{quoted(name)} = {quoted(units.get(name, '1'))}" for name in columns)
    return "{ " + ", ".join(pairs) + " }"


def _file_name(folder: Path, name: str) -> str:
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise DataError(
            f"{folder}: found source {name!r}, expected a name of letters and digits"
        )
    return f"{name}.csv"
