"""GPX files: the points of tracks, with their times."""

import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from kedge.core.errors import DataError
from kedge.core.registry import readers
from kedge.formats.logs import RawLog
from kedge.formats.tables import in_order, table_of
from kedge.formats.text import read_text
from kedge.formats.times import since_1970


@readers.add("gpx")
def read_gpx(path: Path, part: str | None = None) -> RawLog:
    """Read all track points of a file as the source ``gnss``.

    Raises:
        DataError: it has parts, is no GPX, or a point lacks its place or time.
    """
    if part is not None:
        raise DataError(f"{path}: found part {part!r}, expected none: a file has no parts")
    try:
        root = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as error:
        raise DataError(f"{path}: no readable GPX: {error}") from error
    stamps, rows = [], []
    for number, point in enumerate(root.iterfind(".//{*}trkpt"), start=1):
        time, height = point.findtext("{*}time"), point.findtext("{*}ele")
        try:
            when = datetime.datetime.fromisoformat(time or "")
            if when.tzinfo is None:
                when = when.replace(tzinfo=datetime.UTC)
            row = [
                float(point.attrib["lat"]),
                float(point.attrib["lon"]),
                float(height or "nan"),
            ]
        except (KeyError, ValueError) as error:
            raise DataError(
                f"{path}: point {number}: found lat, lon, time = {point.get('lat')}, "
                f"{point.get('lon')}, {time}; expected two numbers and a time"
            ) from error
        stamps.append(since_1970(when))
        rows.append(row)
    if not rows:
        raise DataError(f"{path}: found no track point (trkpt), expected some")
    latitude, longitude, height = np.array(rows).T
    columns = {"latitude": (latitude, "deg"), "longitude": (longitude, "deg")}
    if np.isfinite(height).any():
        columns["altitude"] = (height, "m")
    notes: list[str] = []
    table = in_order(table_of("gnss", path, np.array(stamps, np.int64), columns), notes)
    return RawLog(path.stem, {"gnss": table}, None, {}, (path,), tuple(notes), "Unix")
