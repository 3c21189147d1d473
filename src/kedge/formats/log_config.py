"""``log.toml``: what a log folder says of its files, their columns, units and frames."""

import datetime
from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import model_validator

from kedge.core.errors import DataError
from kedge.core.registry import readers, unknown
from kedge.formats.attitudes import AttitudeConfig
from kedge.formats.cells import NotFinite
from kedge.formats.origin import OriginConfig, unit_errors
from kedge.formats.times import TIME_FORMS
from kedge.formats.toml import Strict
from kedge.formats.units import unit_of

Frame = Literal["enu", "ned"]
FOLDERS = ("bag", "folder")
"""Formats that need to be told more than a file."""


class ColumnConfig(Strict):
    """A column's unit in the file and, if it differs, its name inside."""

    unit: str
    """Its unit in the file."""
    name: str | None = None
    """What it is called inside, if not as in the file."""
    missing: list[str | float] = []
    """What says that a value is missing, beside an empty cell, nan, NA, null and -."""

    @model_validator(mode="before")
    @classmethod
    def _from_unit(cls, value: Any) -> Any:
        return {"unit": value} if isinstance(value, str) else value

    def validation_errors(self) -> Iterator[str]:
        """An unknown unit."""
        try:
            unit_of(self.unit)
        except DataError as error:
            yield f"unit: {error}"


class SourceConfig(Strict):
    """One CSV file."""

    file: str | None = None
    """NAME.csv if not given; it may be packed (.gz)."""
    time: str = "time"
    """The column of times."""
    time_unit: str = "s"
    """Unit or form of the times: s, ms, us, ns, or a form of dates."""
    date: datetime.date | None = None
    """Of the first row, where the times are times of day."""
    week: int | str | None = None
    """The GPS week of week-seconds, or the column that it is in."""
    order: Literal["strict", "sort"] = "strict"
    """Whether rows out of order (by up to 5 s) are sorted, and identical ones dropped."""
    columns: dict[str, ColumnConfig] = {}
    """Column -> unit, or { unit, name, missing }."""
    attitude: AttitudeConfig | None = None
    """Columns that are an attitude together."""
    target: str | None = None
    """The column that names what was seen."""
    frame: Frame | None = None
    """enu or ned; the log's own if not given."""
    not_finite: NotFinite = "error"
    """What a written inf is: an error, or a reading to be rejected."""

    def validation_errors(self) -> Iterator[str]:
        """An unknown unit of time, or two columns that get one name."""
        if self.time_unit not in TIME_FORMS:
            yield f"time_unit: {unknown('unit of time', self.time_unit, list(TIME_FORMS))}"
        if self.time_unit == "week-seconds" and self.week is None:
            yield "week: this key is missing; week-seconds need the GPS week or its column"
        yield from _twice(self.columns)
        yield from unit_errors({name: spec.unit for name, spec in self.columns.items()})


class MapSource(Strict):
    """A map: inline (``ids`` and ``values``), or a CSV file."""

    file: str | None = None
    """A CSV file with a row for each target."""
    id: str = "id"
    """Its column of the targets' names."""
    ids: list[str] | None = None
    """The targets' names, instead of a file."""
    values: dict[str, list[float]] = {}
    """Column -> its value for each target, instead of a file."""
    columns: dict[str, ColumnConfig]
    """Column -> unit, or { unit, name }."""
    frame: Frame | None = None
    """enu or ned; the log's own if not given."""

    def validation_errors(self) -> Iterator[str]:
        """Neither or both kinds, values of another length."""
        yield from _twice(self.columns)
        if (self.ids is None) == (self.file is None):
            yield "ids: expected either ids with values, or a file"
        for name in self.columns if self.ids is not None else ():
            if len(self.values.get(name, ())) != len(self.ids or ()):
                count = len(self.values.get(name, ()))
                yield f"values.{name}: found {count} numbers, expected {len(self.ids or ())}"


class LogConfig(Strict):
    """``log.toml``."""

    title: str = ""
    """What reports are called."""
    epoch: str = ""
    """What time 0 is, for people."""
    frame: Frame = "enu"
    """enu, or ned: north, east, down, with a body of forward, right, down."""
    truth: str | None = None
    """The source to compare with."""
    origin: OriginConfig | Literal["first"] = "first"
    """Of the map, for columns called latitude and longitude."""
    sources: dict[str, SourceConfig] = {}
    """The files, by the name that a rig calls them."""
    files: dict[str, str] = {}
    """Files of other formats -> their format, such as nmea: their sources go with these."""
    maps: dict[str, MapSource] = {}
    """Maps of targets, by name."""

    def validation_errors(self) -> Iterator[str]:
        """A truth that is no source, a format that there is not."""
        for file, format in self.files.items():
            if format not in readers or format in FOLDERS:
                known = [name for name in readers.names() if name not in FOLDERS]
                yield f"files.{file}: {unknown('format of one file', format, known)}"
        if self.truth is not None and self.truth not in self.sources and not self.files:
            yield f"truth: {unknown('source', self.truth, list(self.sources))}"


def _twice(columns: Mapping[str, ColumnConfig]) -> Iterator[str]:
    names = [spec.name or column for column, spec in columns.items()]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"columns: two columns get the name {name!r}"


def log_schema() -> dict[str, Any]:
    """The JSON schema of ``log.toml``."""
    schema = LogConfig.model_json_schema()
    # A column that keeps its name is its unit alone.
    full = {"$ref": "#/$defs/ColumnConfig"}
    for table in ("SourceConfig", "MapSource"):
        columns = schema["$defs"][table]["properties"]["columns"]
        columns["additionalProperties"] = {"anyOf": [{"type": "string"}, full]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema
