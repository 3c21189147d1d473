"""What a log says of latitudes and longitudes: the map's origin, and which fixes are none."""

import re
from collections.abc import Iterator, Mapping
from typing import Annotated

import numpy as np
from pydantic import Field

from kedge.core.errors import DataError
from kedge.formats.cells import Cells
from kedge.formats.tables import Table
from kedge.formats.toml import Strict
from kedge.formats.units import DEGREE

FIX = {"latitude", "longitude"}
SAID = ("status", "fix_quality")
"""Columns that say whether a fix is one."""


class OriginConfig(Strict):
    """Where the map's origin is: degrees north and east, and m over the ellipsoid."""

    latitude: Annotated[float, Field(ge=-90, le=90)]
    """deg, to the north."""
    longitude: Annotated[float, Field(ge=-180, le=180)]
    """deg, to the east."""
    height: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    """m over the ellipsoid."""

    @property
    def place(self) -> dict[str, float]:
        """In rad and m."""
        latitude, longitude = self.latitude * DEGREE, self.longitude * DEGREE
        return {"latitude": latitude, "longitude": longitude, "height": self.height}


def with_status(table: Table, cells: Cells) -> Table:
    """A table of fixes with the columns of its file that say whether they are any."""
    if not table.columns.keys() >= FIX:
        return table
    columns, units = dict(table.columns), dict(table.units)
    for name in SAID:
        if name in columns or name not in cells.columns:
            continue
        try:
            values = cells.numbers(name)
        except DataError:
            continue  # words, of which nobody knows what they mean
        columns[name] = values[np.searchsorted(cells.lines, table.lines)]
        units[name] = "1"
    return table._replace(columns=columns, units=units)


def unit_errors(units: Mapping[str, str]) -> Iterator[str]:
    """A latitude in metres, by the columns' names in the file and their units."""
    for column, unit in units.items():
        fix = re.fullmatch(r"(?i)(latitude|longitude|lat|lon)", column)
        if fix and unit in ("m", "km", "mm"):
            yield (
                f"columns.{column}: found unit {unit!r}, expected deg or rad; columns with the "
                "names latitude and longitude become metres by themselves"
            )
