"""Times as files write them, in ns: numbers of some unit, dates, times of day, GPS weeks.

Whatever has a date comes out in ns since 1970 in UTC, so that sources which write it in
different ways go together.
"""

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta
from decimal import Decimal
from typing import NamedTuple

from kedge.formats.units import TIME_UNITS, nanoseconds

DATED = re.compile(
    r"(\d{4}-?\d\d-?\d\d)[T ](\d\d?:\d\d(?::\d\d)?)(?:[.,](\d+))?\s*(Z|[+-]\d\d:?\d\d)?", re.I
)
CLOCK = re.compile(r"(\d\d?):(\d\d):(\d\d)(?:[.,](\d+))?")
DAY = 86_400 * 10**9
EXCEL = date(1899, 12, 30)
"""Day 0 of spreadsheets, so that theirs are right from March 1900 on."""
GPS = date(1980, 1, 6)
LEAPS = (
    "1981-07-01 1982-07-01 1983-07-01 1985-07-01 1988-01-01 1990-01-01 1991-01-01 1992-07-01 "
    "1993-07-01 1994-07-01 1996-01-01 1997-07-01 1999-01-01 2006-01-01 2009-01-01 2012-07-01 "
    "2015-07-01 2017-01-01"
)
"""Days that began after a leap second, since the GPS clock began.

Source: International Earth Rotation and Reference Systems Service, "Bulletin C", 2016-07-06.
"""
TIME_FORMS = (*TIME_UNITS, "days", "week-seconds")
"""``days`` are a spreadsheet's, ``week-seconds`` those of a GPS week."""


class TimeForm(NamedTuple):
    """How the times of a column are written: the unit of its numbers, and what they lack."""

    unit: str = "s"
    day: date | None = None
    """Of the first row, for times of day."""
    week: str | int | None = None
    """The GPS week, or the column that it is in."""

    def parse(self, cell: str) -> int:
        """One time in ns; dates are known by themselves, whatever the unit.

        Seconds of a week count from its beginning, see :func:`from_gps`.

        Raises:
            ValueError: it is none, or lacks a date or week.
        """
        if dated := DATED.fullmatch(cell):
            return _dated(*dated.groups())
        if clock := CLOCK.fullmatch(cell):
            if self.day is None:
                raise ValueError('a time of day needs date = "YYYY-MM-DD" of its first row')
            hours, minutes, seconds = map(int, clock.groups()[:3])
            if hours > 23 or minutes > 59 or seconds > 60:
                raise ValueError("no such time of day")
            within = (hours * 3600 + minutes * 60 + seconds) * 10**9 + _fraction(clock[4])
            return _since_1970(self.day) + within
        number = Decimal(cell)
        if self.unit == "days":
            return _since_1970(EXCEL) + nanoseconds(number * 86_400, 9)
        if self.unit == "week-seconds":
            return nanoseconds(number, 9)
        return nanoseconds(number, TIME_UNITS[self.unit])


def from_gps(week: int, within: int) -> int:
    """A GPS week and the ns within it, in UTC."""
    gps = _since_1970(GPS) + week * 7 * DAY + within
    days = [_since_1970(date.fromisoformat(day)) for day in LEAPS.split()]
    return gps - sum(gps >= day + n * 10**9 for n, day in enumerate(days, start=1)) * 10**9


def since_1970(when: datetime) -> int:
    """A date and time with its zone, in ns."""
    return (when - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000


def onward(stamps: Sequence[int], period: int = DAY) -> list[int]:
    """Times of a day or week as they go on: going back by more than half of it is the next."""
    result, later = [], 0
    for before, stamp in zip([*stamps[:1], *stamps], stamps, strict=False):
        if before - stamp > period // 2:
            later += 1
        result.append(stamp + later * period)
    return result


def _dated(day: str, clock: str, fraction: str | None, zone: str | None) -> int:
    compact = day.replace("-", "")
    clock = clock if clock.count(":") == 2 else f"{clock}:00"
    whole = datetime.strptime(f"{compact} {clock}", "%Y%m%d %H:%M:%S").replace(tzinfo=UTC)
    stamp = since_1970(whole) + _fraction(fraction)
    if zone and zone.upper() != "Z":
        hours, minutes = int(zone[1:3]), int(zone[-2:])
        stamp -= (-1 if zone[0] == "-" else 1) * (hours * 3600 + minutes * 60) * 10**9
    return stamp


def _fraction(digits: str | None) -> int:
    return int(f"{digits or '0':<09}"[:9])


def _since_1970(day: date) -> int:
    return (day - date(1970, 1, 1)).days * DAY
