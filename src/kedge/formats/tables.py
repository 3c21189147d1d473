"""Tables: one source's rows with exact stamps, in SI units, each knowing its line in the file.

Stamps are parsed as decimals and never pass through a float, which at today's Unix time
resolves only 240 ns. All checks of single values happen here, so that every message can name
file, line and column.
"""

import csv
import gzip
import io
import zlib
from collections.abc import Collection, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int64

from kedge.core.errors import DataError
from kedge.core.registry import unknown
from kedge.formats.units import TIME_UNITS, UNITS, nanoseconds

MOST_DISORDER = 5.0
"""s by which a row may be late: what is sorted."""
NotFinite = Literal["error", "reject"]


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


class Cells(NamedTuple):
    """The text of a table, by column."""

    path: Path
    columns: dict[str, list[str]]
    lines: Int64[np.ndarray, " n"]

    def text(self, column: str) -> list[str]:
        """A column without the blanks around its cells.

        Raises:
            DataError: there is none; the message lists those that there are.
        """
        if column not in self.columns:
            raise DataError(f"{self.path}:1: {unknown('column', column, list(self.columns))}")
        return [cell.strip() for cell in self.columns[column]]

    def numbers(
        self, column: str, unit: str = "1", not_finite: NotFinite = "error"
    ) -> Float[np.ndarray, " n"]:
        """A column in SI units; an empty cell is NaN, which means that the value is missing.

        With ``not_finite="reject"`` an infinity and a written NaN come out as an infinity,
        which the estimator answers with the verdict NOT_FINITE.

        Raises:
            DataError: a cell is no number or not finite.
        """
        text = self.text(column)
        if unit not in UNITS:
            raise DataError(
                f"{self.path}: column {column!r}: {unknown('unit', unit, list(UNITS))}"
            )
        values = np.array(self._parsed(column, text, float, "a number"), float)
        empty = np.array([not cell for cell in text], bool)
        bad = ~np.isfinite(values) & ~empty
        if bad.any() and not_finite == "error":
            at = int(np.argmax(bad))
            raise self._wrong(at, column, repr(text[at]), "a finite number")
        return np.where(bad & np.isnan(values), np.inf, values) * UNITS[unit][1]

    def stamps(self, column: str, unit: str = "s") -> Int64[np.ndarray, " n"]:
        """A column of times in ns, rounded only beyond the nanosecond.

        Raises:
            DataError: a cell is no time, or is out of the range of 64-bit nanoseconds.
        """
        if unit not in TIME_UNITS:
            raise DataError(
                f"{self.path}: column {column!r}: {unknown('unit', unit, list(TIME_UNITS))}"
            )
        power = TIME_UNITS[unit]
        stamps = self._parsed(
            column, self.text(column), lambda cell: nanoseconds(Decimal(cell), power), "a time"
        )
        wide = [at for at, stamp in enumerate(stamps) if not -(2**63) <= stamp < 2**63]
        if wide:
            shown = repr(self.columns[column][wide[0]])
            raise self._wrong(wide[0], column, shown, f"a time in {unit} within 292 years of 0")
        return np.array(stamps, np.int64)

    def _parsed(self, column: str, text: list[str], parse, kind: str) -> list:
        filled = [cell or "nan" for cell in text] if parse is float else text
        try:
            # Python reads 1_000 as a number; in a file it is more likely a slip.
            if "_" not in "".join(filled):
                return list(map(parse, filled))
        except (ValueError, ArithmeticError):
            pass
        for at, cell in enumerate(filled):
            try:
                parse("wrong" if "_" in cell else cell)
            except (ValueError, ArithmeticError):
                raise self._wrong(at, column, repr(text[at]), kind) from None
        raise AssertionError("one cell could not be parsed")

    def _wrong(self, at: int, column: str, shown: str, expected: str) -> DataError:
        place = f"{self.path}:{self.lines[at]}: column {column!r}"
        return DataError(f"{place}: found {shown}, expected {expected}")


def read_cells(path: Path, header: Sequence[str] | None = None) -> Cells:
    """Read a CSV file with a header line, or one of ``header``'s columns between blanks.

    In the second kind, text after a # is a comment. Files ending in .gz are unpacked.

    Raises:
        DataError: the file is missing, unreadable or has no rows, or a row is ragged.
    """
    text, rows, lines = read_text(path), [], []
    if header is None:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        try:
            for row in reader:
                if row:
                    rows.append(row)
                    lines.append(reader.line_num)
        except csv.Error as error:
            raise DataError(f"{path}:{reader.line_num}: no readable CSV: {error}") from error
        header = [name.strip() for name in rows.pop(0)] if rows else []
        lines = lines[1:]
    else:
        for number, line in enumerate(text.splitlines(), start=1):
            if row := line.partition("#")[0].split():
                rows.append(row)
                lines.append(number)
    twice = {name for name in header if header.count(name) > 1}
    if twice:
        raise DataError(f"{path}:1: two columns are called {min(twice)!r}; names must differ")
    if not rows:
        raise DataError(f"{path}: empty log: found no rows, expected at least one")
    for row, line in (
        zip(rows, lines, strict=True) if {*map(len, rows)} != {len(header)} else ()
    ):
        if len(row) != len(header):
            raise DataError(
                f"{path}:{line}: found {len(row)} cells, expected {len(header)}: "
                f"{', '.join(header)}"
            )
    columns = zip(header, zip(*rows, strict=True), strict=True)
    return Cells(
        path, {name: list(cells) for name, cells in columns}, np.array(lines, np.int64)
    )


def build_table(
    cells: Cells,
    name: str,
    time: str,
    time_unit: str,
    columns: Mapping[str, tuple[str, str]],
    target: str | None = None,
    not_finite: NotFinite = "error",
) -> Table:
    """Convert text to a table; its order is not checked yet, see :func:`check_order`.

    Args:
        cells: the text.
        name: what the source is called.
        time: the column of stamps.
        time_unit: s, ms, us or ns.
        columns: column in the file -> its name inside and its unit in the file.
        target: a column of text.
        not_finite: what a written NaN or infinity is: an error, or a reading to be rejected.

    Raises:
        DataError: a column is missing or a cell cannot be understood.
    """
    return Table(
        name,
        cells.path,
        cells.stamps(time, time_unit),
        {
            inside: cells.numbers(column, unit, not_finite=not_finite)
            for column, (inside, unit) in columns.items()
        },
        {} if target is None else {target: cells.text(target)},
        cells.lines,
        {inside: UNITS[unit][0] for inside, unit in columns.values()},
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
    for column, (_, unit) in columns.items():
        if unit not in UNITS:
            what = unknown("unit", unit, list(UNITS))
            raise DataError(f"{path}: column {column!r}: {what}")
    return Table(
        name,
        path,
        np.asarray(stamps, np.int64),
        {
            c: np.asarray(values, float) * UNITS[unit][1]
            for c, (values, unit) in columns.items()
        },
        {column: list(values) for column, values in (texts or {}).items()},
        np.arange(1, len(stamps) + 1) if lines is None else np.asarray(lines),
        {column: UNITS[unit][0] for column, (_, unit) in columns.items()},
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


def _check_jump(table: Table, disorder: float) -> None:
    latest = np.maximum.accumulate(table.stamps)
    jump = (latest - table.stamps) / 1e9
    if jump.max() <= disorder:
        return
    at = int(np.argmax(jump > disorder))
    before = int(np.argmax(table.stamps == latest[at]))
    known = {86_400: "midnight in stamps without a date", 604_800: "a new GPS week"}
    looks = next((what for size, what in known.items() if abs(jump[at] - size) < 60), None)
    if looks is None and table.stamps[at] - table.stamps[0] < 0.1 * (
        latest[at] - table.stamps[0]
    ):
        looks = "a second playing of the recording"
    raise DataError(
        f"{table.path}: {table.name}: row {table.lines[at]}: found {table.stamps[at]} ns after "
        f"{latest[at]} ns in row {table.lines[before]}, expected it to go back by at most "
        f"{disorder:g} s{f'; it looks like {looks}' if looks else ''}"
    )


def check_order(table: Table, time: str) -> None:
    """Refuse time that goes backwards, and a stamp (of the same target) that comes twice.

    Raises:
        DataError: with both lines.
    """
    place = f"{table.path}:{{}}: column {time!r}: found "
    steps = np.diff(table.stamps)
    if (steps < 0).any():
        at = int(np.argmax(steps < 0)) + 1
        raise DataError(
            place.format(table.lines[at]) + f"{table.stamps[at]} ns after "
            f"{table.stamps[at - 1]} ns, expected time that does not go backwards"
        )
    if not (steps == 0).any():
        return
    seen: dict[tuple, int] = {}
    for at, key in enumerate(zip(table.stamps.tolist(), *table.texts.values(), strict=True)):
        if key in seen:
            what = f" and {key[1]!r}" if table.texts else ""
            raise DataError(
                place.format(table.lines[at]) + f"{key[0]} ns{what} again after line "
                f"{table.lines[seen[key]]}, expected no time twice in one source"
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


def read_text(path: Path) -> str:
    """The text of a file, unpacked if its name ends in .gz.

    Raises:
        DataError: it is missing or cannot be read.
    """
    try:
        data = path.read_bytes()
        if path.suffix == ".gz":
            data = gzip.decompress(data)
        return data.decode("utf-8-sig")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
