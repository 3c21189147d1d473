"""Tables: one source's rows with exact stamps, in SI units, each knowing its line in the file.

Stamps are parsed as decimals and never pass through a float, which at today's Unix time
resolves only 240 ns. All checks of single values happen here, so that every message can name
file, line and column.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int64

from kedge.core.errors import DataError
from kedge.core.registry import unknown
from kedge.formats.cells import Cells, NotFinite
from kedge.formats.times import TimeForm
from kedge.formats.units import unit_of

MOST_DISORDER = 5.0
"""s by which a row may be late: what is sorted."""


class Table(NamedTuple):
    """The rows of one source in time order."""

    name: str
    path: Path
    stamps: Int64[np.ndarray, " n"]  # ns
    columns: dict[str, np.ndarray]
    """In SI units; NaN where a component is missing."""
    texts: dict[str, list[str]]
    """Columns of text, such as the target that a reading names."""
    lines: Int[np.ndarray, " n"]
    """Line of each row in the file."""
    units: dict[str, str]
    """SI unit of each column."""
    ned: frozenset[str] = frozenset()
    """Covariances that are still of north, east, down: only a rig knows of what they are."""

    def column(self, name: str) -> Float[np.ndarray, " n"]:
        """A column of numbers.

        Raises:
            DataError: there is none; the message lists those that there are.
        """
        if name not in self.columns:
            raise DataError(f"{self.path}: {unknown('column', name, list(self.columns))}")
        return self.columns[name]

    def take(self, rows: Int[np.ndarray, " k"]) -> "Table":
        """The table of some rows."""
        return self._replace(
            stamps=self.stamps[rows],
            columns={name: values[rows] for name, values in self.columns.items()},
            texts={name: [cells[i] for i in rows] for name, cells in self.texts.items()},
            lines=self.lines[rows],
        )


class Column(NamedTuple):
    """What a column is inside."""

    name: str
    unit: str
    """In the file."""
    missing: tuple[str | float, ...] = ()
    """Words and numbers that say that a value is missing, beside the usual words."""


def build_table(
    cells: Cells,
    name: str,
    time: str,
    time_form: str | TimeForm,
    columns: Mapping[str, Column | tuple[str, str]],
    target: str | None = None,
    not_finite: NotFinite = "error",
    notes: list[str] | None = None,
) -> Table:
    """Convert text to a table; its order is not checked yet, see :func:`check_order`.

    Args:
        cells: the text.
        name: what the source is called.
        time: the column of stamps.
        time_form: the unit of its numbers, or all that is known of how they are written.
        columns: column in the file -> its name inside and its unit in the file.
        target: a column of text.
        not_finite: what a written NaN or infinity is: an error, or a reading to be rejected.
        notes: gets what was odd.

    Raises:
        DataError: a column is missing, a cell cannot be understood, or the file itself names
            another unit.
    """
    declared = {
        column: spec if isinstance(spec, Column) else Column(spec[0], spec[1])
        for column, spec in columns.items()
    }
    for column, spec in declared.items():
        if not (written := cells.units.get(column)):
            continue
        said = f"column {column!r}: its row of units says {written!r}, "
        try:
            same = unit_of(written) == unit_of(spec.unit)
        except DataError:
            same = True
            if notes is not None:
                notes.append(
                    f"{cells.path.name}: {said}no unit of ours; {spec.unit!r} was taken"
                )
        if not same:
            raise DataError(f"{cells.path}: {said}the log {spec.unit!r}")
    return Table(
        name,
        cells.path,
        cells.stamps(time, time_form),
        {
            spec.name: cells.numbers(column, spec.unit, not_finite, spec.missing, notes)
            for column, spec in declared.items()
        },
        {} if target is None else {target: cells.text(target)},
        cells.lines,
        {spec.name: unit_of(spec.unit)[0] for spec in declared.values()},
    )


def table_of(
    name: str,
    path: Path,
    stamps: Int64[np.ndarray, " n"],
    columns: Mapping[str, tuple[np.ndarray, str]],
    texts: Mapping[str, Sequence[str]] | None = None,
    lines: Int[np.ndarray, " n"] | None = None,
) -> Table:
    """A table of arrays, for formats that are no text: name -> values and their unit.

    Without ``lines`` each row is called by its number, from 1.

    Raises:
        DataError: a unit is unknown.
    """
    try:
        units = {column: unit_of(unit) for column, (_, unit) in columns.items()}
    except DataError as error:
        raise DataError(f"{path}: {name}: {error}") from None
    return Table(
        name,
        path,
        np.asarray(stamps, np.int64),
        {
            column: np.asarray(values, float) * units[column][1]
            for column, (values, _) in columns.items()
        },
        {column: list(values) for column, values in (texts or {}).items()},
        np.arange(1, len(stamps) + 1) if lines is None else np.asarray(lines),
        {column: unit for column, (unit, _) in units.items()},
    )


def stamps_of(
    path: Path, name: str, seconds: Float[np.ndarray, " n"]
) -> Int64[np.ndarray, " n"]:
    """Stamps in ns, from a column of seconds.

    Raises:
        DataError: one is not finite, or is too far from 0 for 64-bit nanoseconds.
    """
    wide = ~(np.abs(seconds) < 2**62 / 1e9)
    if wide.any():
        at = int(np.argmax(wide))
        raise DataError(
            f"{path}: {name}: row {at + 1}: found {seconds[at]} s, expected a time within 146 "
            "years of 0"
        )
    return np.round(seconds * 1e9).astype(np.int64)


def in_order(table: Table, notes: list[str], disorder: float = np.inf) -> Table:
    """The table in time order, each stamp (and target) once; ``notes`` says what was changed.

    Of several rows with one stamp the last stays, since a later message replaces the earlier.

    Raises:
        DataError: time jumps back by more than ``disorder`` seconds: these are two drives, or
            a clock that began anew.
    """
    backwards = int((np.diff(table.stamps) < 0).sum())
    if backwards:
        _check_jump(table, disorder)
        notes.append(f"{table.name}: time went backwards {backwards} times; rows were sorted")
        table = table.take(np.argsort(table.stamps, kind="stable"))
    if (np.diff(table.stamps) > 0).all():
        return table
    keys = list(zip(table.stamps.tolist(), *table.texts.values(), strict=True))
    last = {key: row for row, key in enumerate(keys)}
    if len(last) == len(keys):
        return table
    values = list(zip(keys, *(c.tolist() for c in table.columns.values()), strict=True))
    same = len(values) - len(set(values))
    for count, what in ((same, "identical rows"), (len(keys) - len(last) - same, "rows")):
        if count:
            why = "" if what == "identical rows" else ", other values; the last stays"
            notes.append(f"{table.name}: dropped {count} {what} of a stamp used before{why}")
    return table.take(np.array(sorted(last.values())))


def sorted_rows(table: Table, time: str, notes: list[str]) -> Table:
    """The table in time order and without identical rows; ``notes`` says what was changed.

    Raises:
        DataError: time jumps back too far, or rows of one stamp differ.
    """
    if len(table.stamps) > 2 and (np.diff(table.stamps) < 0).all():
        notes.append(f"{table.name}: its newest row came first; rows were turned around")
        return table.take(np.arange(len(table.stamps))[::-1])
    backwards = int((np.diff(table.stamps) < 0).sum())
    if backwards:
        _check_jump(table, MOST_DISORDER)
        notes.append(f"{table.name}: time went backwards {backwards} times; rows were sorted")
        table = table.take(np.argsort(table.stamps, kind="stable"))
    columns = [values.tolist() for values in (table.stamps, *table.columns.values())]
    rows = list(map(repr, zip(*columns, *table.texts.values(), strict=True)))  # NaN is no NaN
    first = {row: at for at, row in reversed(list(enumerate(rows)))}
    if len(first) < len(rows):
        notes.append(f"{table.name}: dropped {len(rows) - len(first)} identical rows")
        table = table.take(np.array(sorted(first.values())))
    check_order(table, time)
    return table


def _check_jump(table: Table, disorder: float) -> None:
    latest = np.maximum.accumulate(table.stamps)
    jump = (latest - table.stamps) / 1e9
    if jump.max() <= disorder:
        return
    at = int(np.argmax(jump > disorder))
    before = int(np.argmax(table.stamps == latest[at]))
    raise DataError(
        f"{table.path}: {table.name}: row {table.lines[at]}: found {table.stamps[at]} ns after "
        f"{latest[at]} ns in row {table.lines[before]}, expected it to go back by at most "
        f"{disorder:g} s{_looks_like(table, at)}"
    )


def _looks_like(table: Table, at: int) -> str:
    """What a jump back to row ``at`` may come from."""
    if (np.diff(table.stamps) < 0).all():
        return "; it looks like the newest row comes first"
    latest = int(table.stamps[:at].max())
    jump, last = (latest - int(table.stamps[at])) / 1e9, latest - int(table.stamps[0])
    known = {
        86_400: "midnight in stamps without a date",
        604_800: "a new GPS week, or its rollover",
    }
    looks = next((what for size, what in known.items() if abs(jump - size) < 60), None)
    if (
        looks is None
        and jump > MOST_DISORDER
        and table.stamps[at] - table.stamps[0] < 0.1 * last
    ):
        looks = "a second playing of the recording"
    return f"; it looks like {looks}" if looks else ""


def check_order(table: Table, time: str, remedy: str = "") -> None:
    """Refuse time that goes backwards, and a stamp (of the same target) that comes twice.

    ``remedy`` ends the message where putting in order would help.

    Raises:
        DataError: with both lines.
    """
    place = f"{table.path}:{{}}: column {time!r}: found "
    steps = np.diff(table.stamps)
    if (steps < 0).any():
        at = int(np.argmax(steps < 0)) + 1
        jump = (int(table.stamps[:at].max()) - int(table.stamps[at])) / 1e9
        helps = jump <= MOST_DISORDER or (steps < 0).all()
        raise DataError(
            place.format(table.lines[at]) + f"{table.stamps[at]} ns after "
            f"{table.stamps[at - 1]} ns, expected time that does not go backwards"
            f"{_looks_like(table, at)}{remedy if helps else ''}"
        )
    if not (steps == 0).any():
        return
    seen: dict[tuple, int] = {}
    for at, key in enumerate(zip(table.stamps.tolist(), *table.texts.values(), strict=True)):
        if key in seen:
            same = all(
                np.array_equal(values[at], values[seen[key]], equal_nan=True)
                for values in table.columns.values()
            )
            what = f" and {key[1]!r}" if table.texts else ""
            raise DataError(
                place.format(table.lines[at]) + f"{key[0]} ns{what} again after line "
                f"{table.lines[seen[key]]}, expected no time twice in one source"
                f"{remedy if same else ''}"
            )
        seen[key] = at


def require_finite(table: Table, columns: Collection[str], role: str) -> None:
    """Refuse a table of controls or truth with something missing.

    Raises:
        DataError: with line and column.
    """
    for name in columns:
        bad = ~np.isfinite(table.column(name))
        if bad.any():
            line, value = table.lines[np.argmax(bad)], table.columns[name][np.argmax(bad)]
            shown = "nothing" if np.isnan(value) else f"{value}"
            raise DataError(
                f"{table.path}:{line}: column {name!r}: found {shown}, expected a finite "
                f"number: {role} must be complete"
            )
