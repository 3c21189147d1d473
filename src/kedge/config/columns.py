"""Columns of a log's table by the components of a control or measurement that they hold."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.formats.tables import Table


def find_columns(
    table: Table, wanted: dict[str, str], renamed: Mapping[str, str], place: str
) -> dict[str, Float[np.ndarray, " n"]]:
    """The columns of some components, after a look at their units.

    Raises:
        DataError: one is missing, or of another unit.
    """
    columns = {}
    for part, unit in wanted.items():
        column = renamed.get(part, part)
        if (constant := _number(column)) is not None and column not in table.columns:
            columns[part] = np.full(len(table.stamps), constant)
            continue
        columns[part] = table.column(column)
        if table.units[column] != unit:
            degrees = table.units[column] == "rad" and part.startswith("position_")
            raise DataError(
                f"{table.path}: column {column!r}: found unit {table.units[column]!r}, "
                f"expected {unit!r} for {place}.{part}"
                + "; call the columns latitude and longitude, and they become metres"
                * degrees
            )
    return columns


def _number(text: str) -> float | None:
    """A column that is a number is one for all rows, in the component's own unit."""
    try:
        return float(text)
    except ValueError:
        return None
