"""A ``log.toml`` for CSV files that nobody declared yet: what each column seems to be."""

import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.formats.cells import Cells, read_cells
from kedge.formats.guesses import (
    TARGET,
    TIME,
    TURNING,
    Guess,
    compassed,
    counts_from_north,
    guess,
    in_one_unit,
    plain,
    ticks,
    time_unit,
    weighed,
)
from kedge.formats.tables import build_table, check_order
from kedge.formats.times import DATED
from kedge.formats.toml import quoted

ENDINGS = (".csv", ".csv.gz", ".tsv", ".txt", ".txt.gz")
TRUTH = (
    re.compile(r"(^|_)(gt|truth|ground_?truth|reference|ref|referenz|mocap|vicon|rtk)($|_)"),
    re.compile(r"(^|_)trajectory($|_)"),
)
"""What a truth is called; the second only if nothing is called by the first."""
FORMATS = {".nmea": "nmea", ".ubx": "ublox", ".gpx": "gpx"}
NUMBER = re.compile(r"-?\d+(\.\d+)?")
BODY = ("velocity_body", "angular_rate", "specific_force")
SAMPLE = 2000
"""Rows that a guess is made from."""


class SketchedSource(NamedTuple):
    """One file, as it seems to be."""

    name: str
    file: str
    time: str
    time_unit: str
    target: str | None
    columns: dict[str, Guess]
    attitude: tuple[str, ...]
    """The columns of roll, pitch and heading, in this order; none without all three."""
    ned: str
    """Why its frame is north-east-down; "" if it is not."""
    unknown: tuple[str, ...]
    places: dict[str, dict[str, float]]
    """Where each target is, if the readings tell it."""

    @property
    def is_body(self) -> bool:
        """Whether it tells of the body, whose axes have no names: forward, right, down?"""
        names = {guessed.name for guessed in self.columns.values()}
        return "heading" in names or any(name.startswith(BODY) for name in names)


class SketchedMap(NamedTuple):
    """A file of places of targets."""

    name: str
    file: str
    id: str
    columns: dict[str, Guess]


class SketchedLog(NamedTuple):
    """A folder's files."""

    sources: dict[str, SketchedSource]
    skipped: dict[str, str]
    """File -> why it was left out."""
    truth: str | None
    maps: dict[str, SketchedMap] = {}
    files: dict[str, str] = {}
    """Files of other formats -> the format."""


def sketch_folder(folder: Path, out: Path) -> SketchedLog:
    """Guess at every file with columns in a folder, named as seen from ``out``.

    Raises:
        DataError: there is no file that can be a source.
    """
    sources: dict[str, SketchedSource] = {}
    skipped: dict[str, str] = {}
    maps: dict[str, SketchedMap] = {}
    files: dict[str, str] = {}
    for path in sorted(folder.iterdir()):
        file = os.path.relpath(path.absolute(), out.absolute())
        if path.is_file() and (other := format_of(path)):
            files[file] = other
        if not path.is_file() or not path.name.endswith(ENDINGS):
            continue
        try:
            sketched = _sketched(path, file)
        except DataError as error:
            skipped[path.name] = str(error).removeprefix(f"{path}").lstrip(": ")
        else:
            if isinstance(sketched, SketchedMap):
                maps[sketched.name] = sketched
            else:
                sources[sketched.name] = sketched
    if not sources:
        why = "".join(f"\n{name}: {reason}" for name, reason in skipped.items())
        raise DataError(f"{folder}: found no table with a header and a column of times{why}")
    truths = _truths(sources)
    runs = [name for name in truths if _series(name) == _series(truths[0])]
    if len(runs) > 1:
        for name in _other_runs(sources, runs):
            why = f"of another run; there are {len(runs)}, and this is that of {truths[0]}"
            skipped[Path(sources.pop(name).file).name] = why
    if ned := next((name for name, source in sources.items() if source.ned), ""):
        why = f"as {ned} is: look whether it is true"
        for name, source in sources.items():
            if source.is_body and not source.ned:
                sources[name] = source._replace(ned=why)
    return SketchedLog(sources, skipped, truths[0] if truths else None, maps, files)


def format_of(path: Path) -> str | None:
    """The format of one file that is neither a table nor a bag, by the end of its name."""
    return FORMATS.get(path.suffix.lower())


def _truths(sources: Mapping[str, SketchedSource]) -> list[str]:
    """Sources that are called as truths are, and have positions."""
    placed = [
        name
        for name, source in sources.items()
        if {"position_x", "latitude"} & {guessed.name for guessed in source.columns.values()}
    ]
    by_kind = ([name for name in placed if kind.search(plain(name))] for kind in TRUTH)
    return next(filter(None, by_kind), [])


def _series(name: str) -> str:
    """What files of the same kind have in common: the name without its last number."""
    return re.sub(r"_?\d+$", "", name)


def _other_runs(sources: Mapping[str, SketchedSource], runs: Sequence[str]) -> list[str]:
    """Of the kinds of files that come once a run, those that are not of the first."""
    numbers = {name.removeprefix(_series(name)) for name in runs}
    first = runs[0].removeprefix(_series(runs[0]))
    by_kind = defaultdict(set)
    for name in sources:
        by_kind[_series(name)].add(name.removeprefix(_series(name)))
    return [f"{k}{n}" for k, ns in by_kind.items() if ns == numbers for n in ns - {first}]


def _sketched(path: Path, file: str) -> SketchedSource | SketchedMap:
    cells = read_cells(path)
    numbers = {column: _numbers(cells, column) for column in cells.columns}
    dates = [c for c in numbers if DATED.fullmatch(cells.text(c)[0])]
    times = [c for c, v in numbers.items() if v is not None and TIME.match(plain(c))]
    times = dates or times
    stem = re.sub(r"\W+", "_", re.sub(r"\.(csv|tsv|txt)(\.gz)?$", "", path.name)).strip("_")
    targets = [c for c in numbers if TARGET.match(plain(c))]
    columns = _guessed(cells, {c: v for c, v in numbers.items() if c not in (*times, *targets)})
    if not times:
        places = {c: g for c, g in columns.items() if g.name.startswith("position_")}
        if targets and len(places) > 1:
            return SketchedMap(stem, file.removesuffix(".gz"), targets[0], places)
        words = " ".join(numbers).split()
        if 2 * sum(NUMBER.fullmatch(word) is not None for word in words) > len(words):
            raise DataError(f"{path}:1: found numbers, expected a line with the columns' names")
        raise DataError(f"{path}: found no column of times; there are {', '.join(numbers)}")
    if "dvl" in stem.lower():
        columns = {
            c: g._replace(name=g.name.replace("velocity_", "velocity_body_"))
            if re.fullmatch("velocity_[xyz]", g.name)
            else g
            for c, g in columns.items()
        }
    columns, down = compassed(columns)
    ned = "a column is told downwards" if down else ""
    if not ned and counts_from_north(columns, _of(numbers, columns)):
        ned = "its heading counts from north to the right, by where the vehicle goes"
        swapped = {"position_x": "position_y", "position_y": "position_x"}
        columns = {c: g._replace(name=swapped.get(g.name, g.name)) for c, g in columns.items()}
    angles = {guessed.name: column for column, guessed in columns.items()}
    attitude = tuple(angles[name] for name in TURNING) if angles.keys() >= {*TURNING} else ()
    unknown = [c for c in numbers if c not in columns and c not in (times[0], *targets[-1:])]
    measured = {guessed.name for guessed in columns.values()}
    target = targets[-1] if targets and measured & {"range", "bearing"} else None
    places = _places(cells, target, columns) if target and "range" in measured else {}
    if places:  # the places of the targets, not of the vehicle
        columns = {c: g for c, g in columns.items() if not g.name.startswith("position_")}
    first = numbers[times[0]]
    unit = "s" if dates or first is None else time_unit(times[0], first)
    specs = {column: (guessed.name, guessed.unit) for column, guessed in columns.items()}
    check_order(build_table(cells, stem, times[0], unit, specs, target), times[0])
    return SketchedSource(
        stem,
        file.removesuffix(".gz"),
        times[0],
        "" if dates else unit,
        target,
        columns,
        attitude,
        ned,
        tuple(unknown),
        places,
    )


def _guessed(
    cells: Cells, numbers: Mapping[str, Float[np.ndarray, " n"] | None]
) -> dict[str, Guess]:
    """What each column of numbers may be; of two that mean the same, the shorter name."""
    guesses: dict[str, tuple[str, Guess]] = {}
    for column, values in numbers.items():
        unit = cells.units.get(column)
        guessed = None
        if values is not None:
            guessed = guess(f"{column} [{unit}]" if unit else column, values)
        if guessed and len(column) < len(guesses.get(guessed.name, (column + "+",))[0]):
            guesses[guessed.name] = column, guessed
    columns = dict(guesses.values())
    named = {guessed.name: column for column, guessed in columns.items()}
    if "speed" in named and not named.keys() & {"yaw_rate", "angular_rate_x"}:
        turn = named.get("angular_rate_z")  # all that a vehicle in the plane has of a gyroscope
        columns |= {turn: columns[turn]._replace(name="yaw_rate")} if turn else {}
    told = _of(numbers, columns)
    return ticks(in_one_unit(weighed(columns, told)), told)


def _of(
    numbers: Mapping[str, Float[np.ndarray, " n"] | None], columns: Mapping[str, Guess]
) -> dict[str, Float[np.ndarray, " n"]]:
    return {c: values for c in columns if (values := numbers[c]) is not None}


def _numbers(cells: Cells, column: str) -> Float[np.ndarray, " n"] | None:
    """The first numbers of a column, NaN where one is missing or none; None if it is text."""
    some = {name: text[:SAMPLE] for name, text in cells.columns.items()}
    try:
        values = cells._replace(columns=some).numbers(column, not_finite="reject")
    except DataError:
        return None
    return np.where(np.isfinite(values), values, np.nan)


def _places(
    cells: Cells, target: str, columns: dict[str, Guess]
) -> dict[str, dict[str, float]]:
    """The place of each target, if every row of it tells the same; else nothing."""
    axes = {g.name: cells.numbers(c) for c, g in columns.items() if g.name[:9] == "position_"}
    places: dict[str, dict[str, float]] = {}
    for at, name in enumerate(cells.text(target)):
        place = {axis: float(values[at]) for axis, values in axes.items()}
        if not place or places.setdefault(name, place) != place:
            return {}
    return places


def log_text(log: SketchedLog, title: str) -> str:
    """The sketch as ``log.toml``."""
    lines = [f"title = {quoted(title)}"]
    if log.truth:
        lines.append(f"truth = {quoted(log.truth)}  # by its name")
    if log.files:
        pairs = ", ".join(
            f"{quoted(file)} = {quoted(name)}" for file, name in log.files.items()
        )
        lines.append(f"files = {{ {pairs} }}  # their sources go with those below")
    for source in log.sources.values():
        lines += ["", f"[sources.{source.name}]", f"file = {quoted(source.file)}"]
        lines += [f"time = {quoted(source.time)}"]
        if source.time_unit:
            lines += [f'time_unit = "{source.time_unit}"  # by how large the numbers are']
        lines += [f"target = {quoted(source.target)}"] if source.target else []
        lines += [f'frame = "ned"  # {source.ned}'] if source.ned else []
        if source.attitude:
            names = ", ".join(map(quoted, source.attitude))
            unit = source.columns[source.attitude[0]].unit
            order = f'order = "roll-pitch-heading", unit = "{unit}"'
            lines.append(f"attitude = {{ columns = [{names}], {order} }}")
        lines += ["", f"[sources.{source.name}.columns]"] if source.columns else []
        for column, guessed in source.columns.items():
            if column in source.attitude:
                continue
            what = f'{{ unit = "{guessed.unit}", name = "{guessed.name}" }}'
            lines.append(f"{quoted(column)} = {what}  # {guessed.why}")
        if source.unknown:
            lines.append(f"# not used: {', '.join(source.unknown)}")
    for targets in log.maps.values():
        lines += ["", f"[maps.{targets.name}]", f"file = {quoted(targets.file)}"]
        lines += [f"id = {quoted(targets.id)}", "", f"[maps.{targets.name}.columns]"]
        for column, guessed in targets.columns.items():
            what = f'{{ unit = "{guessed.unit}", name = "{guessed.name}" }}'
            lines.append(f"{quoted(column)} = {what}  # {guessed.why}")
    places = {k: v for s in log.sources.values() for k, v in s.places.items()}
    if places:
        axes = list(next(iter(places.values())))
        ids = ", ".join(map(quoted, places))
        units = ", ".join(f'{axis} = "m"' for axis in axes)
        lines += ["", "[maps.targets]  # as the readings tell", f"ids = [{ids}]"]
        lines += [f"columns = {{ {units} }}", "", "[maps.targets.values]"]
        lines += [f"{a} = [{', '.join(repr(p[a]) for p in places.values())}]" for a in axes]
    lines += [f"# {name} was left out: {why}" for name, why in log.skipped.items()]
    return "\n".join(line.replace("\n", " ") for line in lines) + "\n"
