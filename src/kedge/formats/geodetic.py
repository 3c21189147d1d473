"""Latitude and longitude as metres east, north and up of an origin.

A source that has the columns ``latitude`` and ``longitude`` (and perhaps ``altitude``) gets
``position_x``, ``position_y`` (and ``position_z``) in their place. Fixes that say they are none
are left out: ``status`` below 0 (ROS), ``fix_quality`` 0 (NMEA), or the place 0, 0.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Bool
from pymap3d.enu import geodetic2enu

from kedge.core.errors import DataError
from kedge.formats.logs import RawLog
from kedge.formats.origin import FIX, OriginConfig
from kedge.formats.tables import Table
from kedge.formats.units import DEGREE

FAR = 100e3
"""m from the origin beyond which a user should hear of it."""


def located(raw: RawLog, origin: OriginConfig | None = None) -> RawLog:
    """The log with metres for every latitude and longitude.

    The origin is the one given, else the log's own, else its first fix.

    Raises:
        DataError: a latitude or longitude is beyond the poles or half the earth, or a source
            has no fix at all.
    """
    everything = [*raw.tables.values(), *([] if raw.truth is None else [raw.truth])]
    fixes = [table for table in everything if table.columns.keys() >= FIX]
    if not fixes:
        return raw
    notes = list(raw.notes)
    kept = {table.name: _fixed(table, notes) for table in fixes}
    place, why = _origin(raw, origin, kept.values())
    degrees = ", ".join(f"{place[name] / DEGREE:.8f}" for name in ("latitude", "longitude"))
    notes.append(
        f"positions are metres east and north of {degrees} deg, {place['height']:.2f} m ({why})"
    )
    in_metres = {name: _in_metres(table, place, notes) for name, table in kept.items()}
    return raw._replace(
        tables={name: in_metres.get(name, table) for name, table in raw.tables.items()},
        truth=raw.truth and in_metres.get(raw.truth.name, raw.truth),
        notes=tuple(notes),
        place=place | raw.place,
    )


def _fixed(table: Table, notes: list[str]) -> Table:
    """The rows that are fixes."""
    latitude, longitude = table.columns["latitude"], table.columns["longitude"]
    for name, values, most in (("latitude", latitude, 90), ("longitude", longitude, 360)):
        wrong = np.abs(values) > most * DEGREE * (1 + 1e-12)
        if wrong.any():
            at = int(np.argmax(wrong))
            raise DataError(
                f"{table.path}:{table.lines[at]}: {table.name}: found a {name} of "
                f"{values[at] / DEGREE:.6g} deg, expected at most {most}; is its unit right, "
                "or are latitude and longitude swapped?"
            )
    kept = np.ones(len(table.stamps), bool)
    for why, lost in _without_fix(table):
        if count := int((lost & kept).sum()):
            notes.append(f"{table.name}: {count} readings without a fix ({why}) were left out")
        kept &= ~lost
    if not kept.any():
        raise DataError(f"{table.path}: {table.name}: found no fix at all, expected some")
    return table.take(np.flatnonzero(kept))


def _without_fix(table: Table) -> Iterator[tuple[str, Bool[np.ndarray, " n"]]]:
    columns = table.columns
    if "status" in columns:
        yield "status below 0", columns["status"] < 0
    if "fix_quality" in columns:
        yield "quality 0", columns["fix_quality"] == 0
    yield "at 0, 0", (columns["latitude"] == 0) & (columns["longitude"] == 0)


def _origin(
    raw: RawLog, origin: OriginConfig | None, fixes: Iterable[Table]
) -> tuple[dict[str, float], str]:
    if origin is not None:
        return origin.place, "the origin of the rig"
    if raw.place.keys() >= FIX:
        return {"height": 0.0} | raw.place, "the origin of the log"
    firsts = []
    for table in fixes:
        known = np.isfinite(table.columns["latitude"] + table.columns["longitude"])
        if known.any():
            at = int(np.argmax(known))
            place = {name: float(table.columns[name][at]) for name in sorted(FIX)}
            height = float(table.columns.get("altitude", np.zeros(at + 1))[at])
            place["height"] = height if np.isfinite(height) else 0.0
            firsts.append((int(table.stamps[at]), table.name, place))
    if not firsts:
        raise DataError(f"{raw.title or 'log'}: found no fix to take the origin from")
    _, name, place = min(firsts, key=lambda first: first[0])
    return place, f"the first fix of {name}"


def _in_metres(table: Table, place: dict[str, float], notes: list[str]) -> Table:
    columns, units = dict(table.columns), dict(table.units)
    latitude, longitude = columns.pop("latitude"), columns.pop("longitude")
    height = columns.pop("altitude", None)
    above = np.full(len(latitude), place["height"]) if height is None else height
    # A height that is missing spoils neither of the other two.
    filled = np.where(np.isnan(above), place["height"], above)
    east, north, up = geodetic2enu(
        latitude, longitude, filled, place["latitude"], place["longitude"], place["height"],
        deg=False,
    )  # fmt: skip
    far = float(np.nanmax(np.hypot(east, north)))
    if far > FAR:
        notes.append(
            f"{table.name}: up to {far / 1e3:.0f} km from the origin; is it the right one?"
        )
    columns |= {"position_x": np.asarray(east), "position_y": np.asarray(north)}
    if height is not None:
        columns["position_z"] = np.where(np.isnan(above), np.nan, up)
    units |= dict.fromkeys(("position_x", "position_y", "position_z"), "m")
    return table._replace(columns=columns, units={name: units[name] for name in columns})
