"""A log's tables as the controls and readings of a rig's vehicle and sensors."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int64

from kedge.config.columns import find_columns
from kedge.config.covariances import read_covariances
from kedge.config.questions import odd_angles, odd_ranges
from kedge.config.rigs import AbstractRigConfig, RigConfig
from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ConfigError, DataError
from kedge.core.manifolds import charts_of, columns_of, space_of
from kedge.core.registry import sensors, unknown
from kedge.estimation.log import SECOND, Readings, Stamped
from kedge.formats.attitudes import no_rotation
from kedge.formats.inertial import SLOPE, held, question, unit_of
from kedge.formats.logs import RawLog, TargetMap
from kedge.formats.odometry import POSE, counted, driven
from kedge.formats.tables import Table, require_finite


def find_table(raw: RawLog, name: str, place: str) -> Table:
    """A source of the log.

    Raises:
        DataError: there is none of that name.
    """
    if name not in raw.tables:
        raise DataError(f"{place}: {unknown('source', name, list(raw.tables))}")
    return raw.tables[name]


def _fields(cls: Any, columns: Mapping[str, Float[np.ndarray, " n"]], rows: int) -> Any:
    """Columns joined to the fields of a state, control or measurement."""
    return cls(
        **{
            field: join(columns, columns_of(field, chart), (rows, *chart.shape))
            for field, chart in charts_of(cls).items()
        }
    )


def join(
    columns: Mapping[str, Float[np.ndarray, " n"]], names: Sequence[str], shape: tuple[int, ...]
) -> Float[np.ndarray, "n ..."]:
    """The columns of one field as one array."""
    return np.stack([columns[name] for name in names], axis=-1).reshape(shape)


def read_controls(
    config: RigConfig, raw: RawLog, vehicle: AbstractVehicle, notes: list[str]
) -> tuple[Int64[np.ndarray, " n"], Any]:
    """The stamps and values of the vehicle's control; no stamps if it is not driven.

    What is odd about them goes into ``notes``.

    Raises:
        DataError: a column is missing, of another unit or not complete, or an inertial
            measurement unit cannot have read this.
    """
    cls = type(vehicle.nominal_control(0.0))
    if config.control is None:
        return np.zeros(0, np.int64), cls()
    table = find_table(raw, config.control.source, f"{config.origin}: control.source")
    sampling, units = config.control.sampling, space_of(cls).column_units
    wanted = {part: unit_of(u, sampling) for part, u in units.items() if SLOPE not in part}
    if sampling == "poses":
        wanted = POSE
    named = [config.control.columns.get(part, part) for part in wanted]
    if sampling != "increments":  # of which none can be left out
        table = _without_missing(table, [n for n in named if n in table.columns], notes)
    columns = find_columns(table, wanted, config.control.columns, "control")
    require_finite(table, [n for n in named if n in table.columns], "a control")
    if sampling == "counts":
        columns = counted(columns, config.control.counter)
    elif sampling == "poses":
        columns = driven(columns)
    if sampling in ("counts", "poses"):
        sampling = "increments"
    if sampling != "previous" or len(wanted) < len(units):
        columns = held(table.stamps, columns, sampling)
    controls = _fields(cls, columns, len(table.stamps))
    notes += odd_angles("control", columns)
    if hasattr(controls, "specific_force"):
        notes += question(table, controls.specific_force, controls.angular_rate)
    return table.stamps, controls


def _without_missing(table: Table, names: Sequence[str], notes: list[str]) -> Table:
    """The rows of a control in which nothing is missing, if there are any."""
    missing = np.any([np.isnan(table.columns[name]) for name in names], axis=0)
    if not missing.any() or missing.all():
        return table
    notes.append(
        f"control: {missing.sum()} of {len(missing)} rows lack a number and were left out; "
        "the control before them goes on"
    )
    return table.take(np.flatnonzero(~missing))


def map_of(config: AbstractRigConfig, name: str, maps: Mapping[str, TargetMap]) -> TargetMap:
    """The map of a sensor's targets, the file's own or one of ``maps``.

    Raises:
        ConfigError: neither has one of that name.
    """
    wanted = config.sensors[name].map or ""
    if wanted in config.maps:
        spec = config.maps[wanted]
        columns = {column: np.array(values) for column, values in spec.columns.items()}
        return TargetMap(tuple(spec.ids), columns)
    if wanted not in maps:
        known = [*config.maps, *maps]
        raise ConfigError(
            f"{config.origin}: sensors.{name}.map: {unknown('map', wanted, known)}"
        )
    return maps[wanted]


def keep_targets(config: RigConfig, raw: RawLog, name: str, notes: list[str]) -> Table:
    """The sensor's source without the targets to be ignored."""
    spec = config.sensors[name]
    table = find_table(raw, spec.source or name, f"{config.origin}: sensors.{name}.source")
    if spec.map is None:
        return table
    column = spec.target or "target"
    if column not in table.texts:
        what = unknown("column of targets", column, list(table.texts))
        raise DataError(f"{table.path}: {what} (for sensors.{name}.target)")
    ignored = set(spec.ignore_targets)
    kept = np.array([target not in ignored for target in table.texts[column]], bool)
    if not kept.all():
        names = ", ".join(spec.ignore_targets)
        notes.append(f"{name}: {int((~kept).sum())} readings of targets {names} were left out")
    return table.take(np.flatnonzero(kept))


def read_readings(
    config: RigConfig, raw: RawLog, name: str, table: Table, cls: Any, notes: list[str]
) -> Stamped:
    """A sensor's readings at their event times: the stamps less the latency.

    What cannot have been measured, such as a range of 0, becomes an infinity, which the
    estimator answers with the verdict NOT_FINITE; ``notes`` counts it.

    Raises:
        DataError: a column is missing or of another unit.
    """
    spec = config.sensors[name]
    columns = find_columns(table, space_of(cls).column_units, spec.columns, f"sensors.{name}")
    for part in sensors.get(spec.model).positive:
        wrong = columns[part] <= 0
        if wrong.any():
            line = table.lines[np.argmax(wrong)]
            notes.append(
                f"{name}: {int(wrong.sum())} readings of {part} are not above 0, the first in "
                f"line {line}; they are refused"
            )
            columns[part] = np.where(wrong, np.inf, columns[part])
    for field, chart in charts_of(cls).items():
        if chart.shape == chart.tangent_shape:
            continue
        parts = columns_of(field, chart)
        wrong = no_rotation(np.stack([columns[part] for part in parts], axis=-1))
        if wrong.any():
            line = table.lines[np.argmax(wrong)]
            notes.append(
                f"{name}: {int(wrong.sum())} readings of {field} are no rotation (their length "
                f"is not 1), the first in line {line}; they are refused"
            )
            columns |= {part: np.where(wrong, np.inf, columns[part]) for part in parts}
    target = np.zeros(len(table.stamps), np.int64)
    notes += odd_angles(name, columns)
    if spec.map is not None:
        if "range" in columns:
            notes += odd_ranges(name, columns["range"], map_of(config, name, raw.maps))
        index = {target: at for at, target in enumerate(map_of(config, name, raw.maps).ids)}
        texts = table.texts[spec.target or "target"]
        target = np.array([index.get(text, -1) for text in texts], np.int64)
        if strange := sorted(set(texts) - set(index)):
            notes.append(
                f"{name}: {int((target < 0).sum())} readings name targets that are not on the "
                f"map: {', '.join(strange[:5])}{' and more' * (len(strange) > 5)}; "
                "they are refused"
            )
    readings = Readings(
        _fields(cls, columns, len(table.stamps)),
        jnp.asarray(target),
        read_covariances(spec, name, table, cls, columns, notes),
    )
    return Stamped(table.stamps - round(spec.latency * SECOND), readings)
