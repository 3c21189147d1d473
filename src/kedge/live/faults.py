"""Faults that can be switched while rows pass: what is sent is changed, never what is true."""

from typing import Any, NamedTuple

import numpy as np

from kedge.core.errors import DataError
from kedge.estimation.log import SECOND
from kedge.estimation.rows import NO_SENSOR

KINDS: dict[str, tuple[str, float]] = {
    "dropout": ("silence: nothing arrives", 15.0),
    "nan": ("readings that are no numbers", 10.0),
    "outliers": ("readings off by 30 sigma", 10.0),
    "clock": ("stamps 3 s in the past", 10.0),
}
"""Name: what it does, and how long it usually lasts in s."""
BEHIND = 3.0  # s
TIMES = 30.0


class Switched(NamedTuple):
    """A fault of some sources of one vehicle, from ``start`` to ``end`` (s of the stream)."""

    id: int
    kind: str
    vehicle: int
    source: int | None
    start: float
    end: float

    @classmethod
    def checked(
        cls, number: int, kind: Any, vehicle: int, source: Any, sources: int, now: float,
        seconds: Any,
    ) -> "Switched":  # fmt: skip
        """A fault as somebody asked for it.

        Raises:
            DataError: there is no such fault or source, or the duration is of no use.
        """
        if not isinstance(kind, str) or kind not in KINDS:
            raise DataError(f"fault: kind is {kind!r}, expected one of {', '.join(KINDS)}")
        if source is not None and (type(source) is not int or not 0 <= source < sources):
            raise DataError(
                f"fault: source is {source!r}, expected 0 to {sources - 1}, or null"
            )
        lasting = KINDS[kind][1] if seconds is None else seconds
        if type(lasting) not in (int, float) or not 0 < lasting <= 3600:
            raise DataError(f"fault: seconds is {seconds!r}, expected more than 0, up to 3600")
        return cls(number, kind, vehicle, source, now, now + lasting)


def with_fault(
    rows: np.ndarray, fault: Switched, concerned: np.ndarray, std: np.ndarray
) -> np.ndarray:
    """The rows as they are sent; ``concerned`` are sensors, ``std`` is theirs by component."""
    hit = np.isin(rows["sensor"], concerned)
    if not hit.any():
        return rows
    rows = rows.copy()
    if fault.kind == "dropout":
        rows["sensor"][hit] = NO_SENSOR
    elif fault.kind == "nan":
        rows["measurement"][hit] = np.nan
    elif fault.kind == "outliers":
        width = rows["measurement"].shape[1]
        rows["measurement"][hit] += TIMES * std[rows["sensor"][hit], :width]
    else:
        rows["time"][hit] -= round(BEHIND * SECOND)
    return rows
