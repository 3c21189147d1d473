"""NMEA 0183 files, as a receiver writes them: GGA for the place, RMC or VTG for the velocity.

Their sentences tell the time of day; the date is that of RMC or ZDA. Without any, stamps count
from midnight of the first day. Read by ``pynmeagps``: ``pip install 'kedge-nav[nautical]'``.
"""

import datetime
from pathlib import Path
from typing import Any

import numpy as np

from kedge.core.errors import DataError
from kedge.core.registry import readers
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table, in_order, table_of
from kedge.formats.text import read_text
from kedge.formats.times import since_1970

DAY = datetime.timedelta(days=1)
HALF = DAY / 2
MIDNIGHT = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
COLUMNS: dict[str, dict[str, str]] = {
    "gnss": {
        "latitude": "deg",
        "longitude": "deg",
        "altitude": "m",
        "fix_quality": "1",
        "hdop": "1",
    },
    "velocity": {"velocity_x": "kn", "velocity_y": "kn"},
}


class _Clock:
    """The time of sentences that tell no date, across midnight."""

    def __init__(self) -> None:
        self.last: datetime.datetime | None = None
        self.dated = False

    def at(self, time: datetime.time, date: datetime.date | None) -> int:
        """A stamp in ns."""
        day = date or (MIDNIGHT if self.last is None else self.last).date()
        now = datetime.datetime.combine(day, time, datetime.UTC)
        if date is None and self.last is not None and now - self.last < -HALF:
            now += DAY
        self.last, self.dated = now, self.dated or date is not None
        return since_1970(now)


@readers.add("nmea")
def read_nmea(path: Path, part: str | None = None) -> RawLog:
    """Read a file of sentences; damaged ones are counted in the notes.

    Raises:
        DataError: it has parts, cannot be read, or has no position.
    """
    if part is not None:
        raise DataError(f"{path}: found part {part!r}, expected none: a file has no parts")
    try:
        from pynmeagps import NMEAReader
    except ImportError:
        raise DataError(
            f"{path}: reading NMEA needs another package: pip install 'kedge-nav[nautical]'"
        ) from None
    sentences: list[tuple[int, Any]] = []
    wrong: list[tuple[int, object]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        at = line.find("$")  # loggers like to put a time of their own before it
        if at < 0:
            continue
        try:
            sentence = NMEAReader.parse(line[at:].strip().encode())
        except Exception as error:  # a library's many, and to the user one: it is damaged
            wrong.append((number, error))
            continue
        if sentence is None:
            wrong.append((number, "no sentence"))
        else:
            sentences.append((number, sentence))
    rows = _rows(sentences)
    notes = []
    if wrong:
        number, error = wrong[0]
        notes.append(
            f"{len(wrong)} damaged sentences were left out, the first in line {number}: {error}"
        )
    tables = {
        name: _table(path, name, entries, notes) for name, entries in rows.items() if entries
    }
    if "gnss" not in tables:
        raise DataError(f"{path}: found no GGA sentence that is whole, expected some")
    dated = any(getattr(s, "date", None) for _, s in sentences)
    epoch = "Unix" if dated else "midnight (UTC) of the first day"
    return RawLog(path.stem, tables, None, {}, (path,), tuple(notes), epoch)


def _rows(sentences: list[tuple[int, Any]]) -> dict[str, list[tuple[int, int, list[float]]]]:
    """By table: stamp, line and values of each row."""
    clock, stamp = _Clock(), None
    dates = (
        s.date for _, s in sentences if isinstance(getattr(s, "date", None), datetime.date)
    )
    clock.last = _first_day(next(dates, None), sentences)
    rows: dict[str, list[tuple[int, int, list[float]]]] = {name: [] for name in COLUMNS}
    has_rmc = any(s.msgID == "RMC" for _, s in sentences)
    for number, sentence in sentences:
        time, date = getattr(sentence, "time", None), getattr(sentence, "date", None)
        if isinstance(time, datetime.time):
            stamp = clock.at(time, date if isinstance(date, datetime.date) else None)
        if stamp is None:
            continue
        if sentence.msgID == "GGA":
            # A receiver tells the height over the geoid; with the separation, over WGS 84.
            height = _number(sentence.alt) + np.nan_to_num(_number(sentence.sep))
            place = [_number(sentence.lat), _number(sentence.lon), height]
            quality = [_number(sentence.quality), _number(sentence.HDOP)]
            rows["gnss"].append((stamp, number, place + quality))
        elif sentence.msgID == "RMC" or (sentence.msgID == "VTG" and not has_rmc):
            if getattr(sentence, "status", "A") == "V":
                continue
            rmc = sentence.msgID == "RMC"
            speed = _number(sentence.spd if rmc else sentence.sogn)
            course = np.radians(_number(sentence.cog if rmc else sentence.cogt))
            both = [float(speed * np.sin(course)), float(speed * np.cos(course))]
            if np.isfinite(both).all():  # who stands has no course
                rows["velocity"].append((stamp, number, both))
    return rows


def _first_day(
    date: datetime.date | None, sentences: list[tuple[int, Any]]
) -> datetime.datetime | None:
    """Where the clock begins: sentences before the first date are of that day."""
    if date is None:
        return None
    times = (getattr(s, "time", None) for _, s in sentences)
    first = next((t for t in times if isinstance(t, datetime.time)), datetime.time())
    return datetime.datetime.combine(date, first, datetime.UTC)


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def _table(
    path: Path, name: str, entries: list[tuple[int, int, list[float]]], notes: list[str]
) -> Table:
    stamps, lines, values = zip(*entries, strict=True)
    units = COLUMNS[name].items()
    columns = {
        column: (np.array(part, float), unit)
        for (column, unit), part in zip(units, zip(*values, strict=True), strict=True)
    }
    table = table_of(name, path, np.array(stamps), columns, lines=np.array(lines))
    return in_order(table, notes)
