"""u-blox receivers' own files: the message NAV-PVT, with its accuracies.

Read by ``pyubx2``: ``pip install 'kedge-nav[nautical]'``. NMEA sentences between the messages
are passed over; ``format = "nmea"`` reads those.
"""

import datetime
import io
from pathlib import Path
from typing import Any

import numpy as np

from kedge.core.errors import DataError
from kedge.core.registry import readers
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table, in_order, table_of
from kedge.formats.times import since_1970

FIXES = (2, 3, 4)
"""Kinds of fix that have a place: in plan, in space, with dead reckoning."""
UBX_ONLY, PASS_OVER = 2, 1
COLUMNS: dict[str, dict[str, tuple[str, str]]] = {
    "gnss": {
        "latitude": ("lat", "deg"),
        "longitude": ("lon", "deg"),
        "altitude": ("height", "mm"),
        "horizontal_std": ("hAcc", "mm"),
        "vertical_std": ("vAcc", "mm"),
        "fix_quality": ("fixType", "1"),
    },
    "velocity": {
        "velocity_x": ("velE", "mm/s"),
        "velocity_y": ("velN", "mm/s"),
        "velocity_z": ("velD", "mm/s"),
        "velocity_std": ("sAcc", "mm/s"),
    },
}
"""By source: column -> field of the message, and its unit."""


@readers.add("ublox")
def read_ublox(path: Path, part: str | None = None) -> RawLog:
    """Read the NAV-PVT messages of a file; damaged ones are counted in the notes.

    Raises:
        DataError: it has parts, cannot be read, or has no NAV-PVT with a time.
    """
    if part is not None:
        raise DataError(f"{path}: found part {part!r}, expected none: a file has no parts")
    try:
        from pyubx2 import UBXReader
    except ImportError:
        raise DataError(
            f"{path}: reading u-blox files needs another package: "
            "pip install 'kedge-nav[nautical]'"
        ) from None
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error}") from None
    wrong: list[Any] = []
    reader: Any = UBXReader
    stream = reader(
        io.BytesIO(data), protfilter=UBX_ONLY, quitonerror=PASS_OVER, errorhandler=wrong.append
    )
    solutions: list[Any] = []
    try:
        solutions += (m for _, m in stream if getattr(m, "identity", "") == "NAV-PVT")
    except Exception as error:  # what the library lets through is damage of another kind
        raise DataError(
            f"{path}: cannot be read after {len(solutions)} NAV-PVT messages: {error}"
        ) from error
    timed = [m for m in solutions if m.validDate and m.validTime]
    if not timed:
        raise DataError(
            f"{path}: found no NAV-PVT message with a valid time among {len(solutions)}"
        )
    notes = []
    if wrong:
        notes.append(f"{len(wrong)} damaged messages were left out, the first: {wrong[0]}")
    if early := len(solutions) - len(timed):
        notes.append(f"{early} messages before the receiver knew the time were left out")
    stamps = np.array([_stamp(message) for message in timed], np.int64)
    tables = {name: _table(path, name, stamps, timed, notes) for name in COLUMNS}
    return RawLog(path.stem, tables, None, {}, (path,), tuple(notes), "Unix")


def _stamp(message: Any) -> int:
    """ns; the fraction of a second may be below 0."""
    when = datetime.datetime(
        message.year, message.month, message.day, message.hour, message.min,
        min(message.second, 59), tzinfo=datetime.UTC,
    )  # fmt: skip
    leap = message.second - min(message.second, 59)
    return since_1970(when) + leap * 10**9 + message.nano


def _table(
    path: Path, name: str, stamps: np.ndarray, messages: list[Any], notes: list[str]
) -> Table:
    columns = {
        column: (np.array([getattr(m, field) for m in messages], float), unit)
        for column, (field, unit) in COLUMNS[name].items()
    }
    fixed = np.array([m.fixType in FIXES and bool(m.gnssFixOk) for m in messages])
    if name == "gnss":
        columns["fix_quality"] = fixed.astype(float), "1"
    else:
        down, unit = columns["velocity_z"]
        columns["velocity_z"] = -down, unit
    table = table_of(name, path, stamps, columns)
    return in_order(table if name == "gnss" else table.take(np.flatnonzero(fixed)), notes)
