"""The cells of text files, by column, as spreadsheets and loggers write them.

What is unambiguous is read, and said in the notes: the delimiter, blanks between columns,
decimal commas, comments, a row of units, a last line that was cut off. What is not is refused
with its line.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, Int64

from kedge.core.errors import DataError
from kedge.core.registry import unknown
from kedge.formats.text import read_text
from kedge.formats.times import CLOCK, DAY, TIME_FORMS, TimeForm, from_gps, onward
from kedge.formats.units import unit_of

T = TypeVar("T")
NotFinite = Literal["error", "reject"]
DELIMITERS = ",;\t|"
COMMENTS = ("#", "%", "//")
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "--"})
"""What says that a value is missing, in capitals or not."""
NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?", re.I)
THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d*")
DECIMAL_COMMA = re.compile(r"[+-]?((0\d*|\d{4,}|),\d*|\d*,(\d{0,2}|\d{4,}))(e[+-]?\d+)?", re.I)
AMBIGUOUS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")


class Cells(NamedTuple):
    """The text of a table, by column."""

    path: Path
    columns: dict[str, list[str]]
    lines: Int64[np.ndarray, " n"]
    delimiter: str = ","
    units: dict[str, str] = {}
    """What a row of units below the names says."""

    def text(self, column: str) -> list[str]:
        """A column without the blanks around its cells.

        Raises:
            DataError: there is none; the message lists those that there are.
        """
        if column not in self.columns:
            raise DataError(f"{self.path}:1: {unknown('column', column, list(self.columns))}")
        return [cell.strip() for cell in self.columns[column]]

    def numbers(
        self,
        column: str,
        unit: str = "1",
        not_finite: NotFinite = "error",
        missing: Collection[str | float] = (),
        notes: list[str] | None = None,
    ) -> Float[np.ndarray, " n"]:
        """A column in SI units; an empty cell is NaN, which means that the value is missing.

        So are the words of :data:`MISSING`, and the words and numbers of ``missing``; ``notes``
        counts them. With ``not_finite="reject"`` an infinity and a written NaN come out as an
        infinity, which the estimator answers with the verdict NOT_FINITE.

        Raises:
            DataError: a cell is no number or not finite.
        """
        text = self.text(column)
        try:
            factor = unit_of(unit)[1]
        except DataError as error:
            raise DataError(f"{self.path}: column {column!r}: {error}") from None
        words = MISSING | {str(word).lower() for word in missing}
        words -= {"nan"} if not_finite == "reject" else set()
        gone = np.array([cell.lower() in words for cell in text], bool)
        filled = ["nan" if empty else cell for cell, empty in zip(text, gone, strict=True)]
        values = np.array(self._parsed(column, self._plain(column, filled), float, "a number"))
        for sentinel in missing:
            if not isinstance(sentinel, str):
                gone |= values == sentinel
        said = Counter(cell for cell, empty in zip(text, gone, strict=True) if empty and cell)
        if notes is not None and said:
            quoted = ", ".join(sorted(map(repr, said))[:3])
            notes.append(
                f"{self.path.name}: {said.total()} cells of {column} are missing: {quoted}"
            )
        bad = ~np.isfinite(values) & ~gone
        if bad.any() and not_finite == "error":
            at = int(np.argmax(bad))
            raise self._wrong(at, column, repr(text[at]), "a finite number")
        values = np.where(gone, np.nan, np.where(np.isnan(values), np.inf, values))
        return values.astype(float) * factor

    def complete(self, column: str) -> Float[np.ndarray, " n"]:
        """A column of which no number is missing.

        Raises:
            DataError: one is, or a cell is no number or not finite.
        """
        values = self.numbers(column)
        if np.isnan(values).any():
            at = int(np.argmax(np.isnan(values)))
            raise self._wrong(at, column, repr(self.text(column)[at]), "a number")
        return values

    def identifiers(self, column: str) -> list[str]:
        """A column of whole numbers that are names, each written in one way.

        Raises:
            DataError: a cell is no whole number.
        """
        return self._parsed(column, self.text(column), _identifier, "a whole number")

    def stamps(
        self, column: str, form: str | TimeForm = "s", notes: list[str] | None = None
    ) -> Int64[np.ndarray, " n"]:
        """A column of times in ns, rounded only beyond the nanosecond.

        Raises:
            DataError: a cell is no time, or is out of the range of 64-bit nanoseconds.
        """
        form = TimeForm(form) if isinstance(form, str) else form
        if form.unit not in TIME_FORMS:
            what = unknown("unit of time", form.unit, list(TIME_FORMS)).replace(
                " of time", "", 1
            )
            raise DataError(f"{self.path}: column {column!r}: {what}")
        text = self._plain(column, self.text(column))
        stamps = self._parsed(column, text, form.parse, "a time")
        if form.unit == "week-seconds":
            stamps = list(map(from_gps, self._weeks(form, len(text)), stamps))
            stamps = onward(stamps, 7 * DAY) if isinstance(form.week, int) else stamps
        if form.day is not None and text and CLOCK.fullmatch(text[0]):
            stamps = onward(stamps)
        wide = [at for at, stamp in enumerate(stamps) if not -(2**63) <= stamp < 2**63]
        if wide:
            found = repr(self.columns[column][wide[0]])
            expected = f"a time in {form.unit} within 292 years of 0"
            raise self._wrong(wide[0], column, found, expected)
        return np.array(stamps, np.int64)

    def _weeks(self, form: TimeForm, count: int) -> list[int]:
        if form.week is None:
            raise DataError(f"{self.path}: week-seconds need week, a number or a column")
        if isinstance(form.week, int):
            return [form.week] * count
        return self._parsed(form.week, self.text(form.week), int, "a GPS week")

    def _plain(self, column: str, text: list[str]) -> list[str]:
        """Numbers with a point, whatever marks their decimals and thousands.

        Raises:
            DataError: nothing says whether a comma is the one or the other.
        """
        if "," not in "".join(text):
            return text
        commas = [at for at, cell in enumerate(text) if "," in cell and not CLOCK.match(cell)]
        marked = [text[at] for at in commas]
        if all(map(THOUSANDS.fullmatch, marked)):
            return [cell.replace(",", "") for cell in text]
        pointed = any("." in cell for cell in text)
        if not pointed and (
            self.delimiter == ";" or any(map(DECIMAL_COMMA.fullmatch, self._all_numbers()))
        ):
            return [cell.replace(",", ".") for cell in text]
        if commas and AMBIGUOUS.fullmatch(marked[0]):
            expected = "a number whose comma marks either thousands or decimals for certain"
            raise self._wrong(commas[0], column, repr(marked[0]), expected)
        return text

    def _all_numbers(self) -> Iterator[str]:
        return (
            cell.strip() for cells in self.columns.values() for cell in cells if "," in cell
        )

    def _parsed(
        self, column: str, text: list[str], parse: Callable[[str], T], kind: str
    ) -> list[T]:
        try:
            # Python reads 1_000 as a number; in a file it is more likely a slip.
            if "_" not in "".join(text):
                return list(map(parse, text))
        except (ValueError, ArithmeticError):
            pass
        for at, cell in enumerate(text):
            try:
                if "_" in cell:
                    raise ValueError
                parse(cell)
            except (ValueError, ArithmeticError) as error:
                hint = f"; {error}" if "date = " in str(error) else ""
                found = repr(self.columns[column][at].strip())
                raise self._wrong(at, column, found, kind + hint) from None
        raise AssertionError("one cell could not be parsed")

    def _wrong(self, at: int, column: str, found: str, expected: str) -> DataError:
        place = f"{self.path}:{self.lines[at]}: column {column!r}"
        return DataError(f"{place}: found {found}, expected {expected}")


class _Row(NamedTuple):
    line: int
    cells: list[str]


def read_cells(
    path: Path, header: Sequence[str] | None = None, notes: list[str] | None = None
) -> Cells:
    """Read a CSV file with a header line, or one of ``header``'s columns between blanks.

    In the second kind, text after a # is a comment. Files ending in .gz are unpacked.

    Raises:
        DataError: the file is missing, unreadable or has no rows, or a row is ragged.
    """
    notes = [] if notes is None else notes
    text = read_text(path, notes)
    if header is not None:
        lines = enumerate(text.splitlines(), start=1)
        rows = [_Row(n, row) for n, line in lines if (row := line.partition("#")[0].split())]
        return _cells(path, header, rows, " ", {})
    delimiter, first = _delimiter(text)
    if delimiter != ",":
        name = {"\t": "tabs", " ": "blanks"}.get(delimiter, repr(delimiter))
        notes.append(f"{path.name}: its cells are separated by {name}")
    rows = list(_csv_rows(path, text, delimiter, first, notes))
    if not rows:
        raise DataError(f"{path}: empty log: found no rows, expected at least one")
    names = [name.strip() for name in rows.pop(0).cells]
    while names and not names[-1]:
        names.pop()
    rows = _of_one_length(path, names, rows, text, notes)
    units = {}
    if rows and _are_units(rows[0].cells):
        units = {
            name: cell.strip(" []()-") for name, cell in zip(names, rows[0].cells, strict=True)
        }
        notes.append(f"{path.name}: line {rows.pop(0).line} was left out: a row of units")
    return _cells(path, names, rows, delimiter, units)


def _cells(
    path: Path, header: Sequence[str], rows: list[_Row], delimiter: str, units: dict[str, str]
) -> Cells:
    twice = {name for name in header if name and header.count(name) > 1}
    if twice:
        raise DataError(f"{path}:1: two columns are called {min(twice)!r}; names must differ")
    if not rows:
        raise DataError(f"{path}: empty log: found no rows, expected at least one")
    if {len(row.cells) for row in rows} != {len(header)}:
        for line, cells in rows:
            if len(cells) != len(header):
                hint = ""
                if delimiter == "," and len(cells) > len(header) and _whole(cells):
                    hint = "; decimal commas between commas cannot be told apart: separate by ;"
                raise DataError(
                    f"{path}:{line}: found {len(cells)} cells, expected {len(header)}: "
                    f"{', '.join(header)}{hint}"
                )
    by_column = zip(header, zip(*(row.cells for row in rows), strict=True), strict=True)
    columns = {name: list(cells) for name, cells in by_column if name}
    return Cells(
        path, columns, np.array([row.line for row in rows], np.int64), delimiter, units
    )


def _delimiter(text: str) -> tuple[str, int]:
    """What separates the cells, and how many lines come before the header."""
    lines = text[:100_000].splitlines()
    first = 0
    if lines and (said := re.fullmatch(r'"?sep=(.)"?[,;\t]*\s*', lines[0], re.I)):
        return said[1], 1
    while first < len(lines) - 1 and (
        not lines[first].strip() or lines[first].lstrip().startswith(COMMENTS)
    ):
        first += 1
    if first and first < len(lines) and _whole(re.split(r"[,;\t| ]", lines[first])):
        first -= 1  # numbers below a comment: it is the header
    header = re.sub(r'"[^"]*"', "", lines[first]) if lines else ""
    counts = {mark: header.count(mark) for mark in DELIMITERS}
    words = len(header.lstrip("#%/ ").split())
    if words > 1 and not any(counts.values()) and len(lines) > first + 1:
        # A date and time of day in one row are two words under one name: no such table.
        return (" " if len(lines[first + 1].split()) == words else ","), first
    return max(counts, key=lambda mark: counts[mark]), first


def _csv_rows(
    path: Path, text: str, delimiter: str, first: int, notes: list[str]
) -> Iterator[_Row]:
    stream = io.StringIO(text, newline="")
    reader = csv.reader(stream, delimiter=delimiter, skipinitialspace=True, strict=True)
    header, comments = True, 0
    try:
        for row in reader:
            line = reader.line_num
            if line <= first or not any(map(str.strip, row)):
                continue
            if header:
                row[0] = row[0].lstrip("".join(COMMENTS) + " ")
                row = row[1:] if delimiter == " " and not row[0] else row
            elif row[0].lstrip().startswith(COMMENTS):
                comments += 1
                continue
            header = False
            yield _Row(line, row)
    except csv.Error as error:
        raise DataError(f"{path}:{reader.line_num}: no readable CSV: {error}") from error
    if comments:
        notes.append(f"{path.name}: {comments} comments between the rows were left out")


def _of_one_length(
    path: Path, names: list[str], rows: list[_Row], text: str, notes: list[str]
) -> list[_Row]:
    """The rows without empty cells beyond the header, and without a last one that was cut."""
    size = len(names)
    if any(len(row.cells) > size for row in rows):
        rows = [
            row if any(map(str.strip, row.cells[size:])) else _Row(row.line, row.cells[:size])
            for row in rows
        ]
    if len(rows) > 1 and not text.endswith(("\n", "\r")) and _is_cut(rows, size):
        notes.append(f"{path.name}: line {rows[-1].line}, the last one, was cut off: left out")
        return rows[:-1]
    return rows


def _is_cut(rows: list[_Row], size: int) -> bool:
    """Whether the last row lacks cells, or decimals that its last cell has in all others."""
    last = rows[-1].cells
    if len(last) < size:
        return True
    decimals = {len(row.cells[-1].strip().partition(".")[2]) for row in rows[:-1]}
    shorter = len(last[-1].strip().partition(".")[2])
    return len(rows) > 3 and len(decimals) == 1 and shorter < max(decimals)


def _are_units(cells: Sequence[str]) -> bool:
    """Whether all are units: of ours or none (-), or whatever else in square brackets."""

    def is_unit(cell: str) -> bool:
        if re.fullmatch(r"\[.*\]", cell.strip()):
            return True
        try:
            unit_of(cell.strip(" []()"))
        except DataError:
            return cell.strip(" []()-") in (*TIME_FORMS, "")
        return not NUMBER.fullmatch(cell)

    said = any(cell.strip(" -") for cell in cells)
    return said and all(map(is_unit, cells))


def _identifier(cell: str) -> str:
    value = float(cell)
    if not value.is_integer():
        raise ValueError
    return str(int(value))


def _whole(cells: Sequence[str]) -> bool:
    return any(cells) and all(
        NUMBER.fullmatch(cell.strip()) or not cell.strip() for cell in cells
    )
