"""The covariances that come with readings, by the conventions of those who write them.

A variance (or deviation) of 0 or an empty cell is one that nobody knew: the sensor's own is
taken. A first variance of -1 says that the whole reading is not there; 1e9 or the largest
number there is, that one component is not. :mod:`kedge.estimation.reading` acts by that, for
live readings too; here it is brought to that form and counted for the user.
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.config.columns import find_columns
from kedge.config.rigs import SensorConfig
from kedge.core.errors import ConfigError, DataError
from kedge.core.manifolds import Space, space_of
from kedge.estimation.reading import NO_COMPONENT, NO_READING
from kedge.formats.tables import Table
from kedge.formats.units import axis_in_enu, product_of


def read_covariances(
    spec: SensorConfig,
    name: str,
    table: Table,
    cls: Any,
    measured: Mapping[str, Float[np.ndarray, " n"]],
    notes: list[str],
) -> Float[Array, "n m m"] | None:
    """The readings' covariances; None if none came with them. ``notes`` counts conventions.

    What is missing in the reading itself gets unit noise, by which nobody goes.

    Raises:
        ConfigError: deviations for an attitude, whose components are no columns.
        DataError: a column is missing, or has another unit than the components' product.
    """
    if spec.std:
        cov = _from_deviations(spec, name, table, cls)
    elif spec.covariance is not None:
        cov = _from_triangle(spec, name, table, cls)
    else:
        return None
    if len(measured) == space_of(cls).size:
        gone = np.isnan(np.stack(list(measured.values()), axis=-1))
        cov = np.where(gone[:, :, None] | gone[:, None, :], np.eye(cov.shape[-1])[None], cov)
    variances = np.diagonal(cov, axis1=1, axis2=2)
    none = (variances[:, :1] == NO_READING).any(axis=1)
    for rows, what in (
        (none, "say by a first variance of -1 that they are not there"),
        (~none & (variances >= NO_COMPONENT).any(axis=1), _HUGE),
        (
            ~none & ~(cov != 0).any(axis=1).all(axis=-1),
            "leave a variance open (0 or empty): its std holds",
        ),
    ):
        if rows.any():
            line = table.lines[np.argmax(rows)]
            notes.append(
                f"{name}: {int(rows.sum())} readings {what}; the first is in line {line}"
            )
    return jnp.asarray(cov)


_HUGE = f"say by a variance of {NO_COMPONENT:g} or more that a component is not there"


def _from_deviations(
    spec: SensorConfig, name: str, table: Table, cls: Any
) -> Float[np.ndarray, "n m m"]:
    size, wanted = space_of(cls).size, space_of(cls).column_units
    if len(wanted) != size:
        raise ConfigError(f"sensors.{name}.std: an attitude needs covariance instead")
    stds = np.stack(
        [*find_columns(table, wanted, spec.std, f"sensors.{name}.std").values()], -1
    )
    # Squaring would hide a negative deviation, which is as bad as a negative variance.
    variances = np.where(stds < 0, np.nan, _known(stds) ** 2)
    return variances[:, :, None] * np.eye(size)


def _from_triangle(
    spec: SensorConfig, name: str, table: Table, cls: Any
) -> Float[np.ndarray, "n m m"]:
    space = space_of(cls)
    cov = np.zeros((len(table.stamps), space.size, space.size))
    above = zip(*np.triu_indices(space.size), strict=True)
    for (row, column), source in zip(above, spec.covariance or (), strict=True):
        values = table.column(source)
        wanted = product_of(space.units[row], space.units[column])
        unit = table.units[source]
        if unit != wanted:
            hint = ""
            if row == column and unit == space.units[row]:
                hint = "; deviations belong in std, variances here"
            raise DataError(
                f"{table.path}: column {source!r}: found unit {unit!r}, expected {wanted!r} "
                f"for sensors.{name}.covariance: {space.labels[row]}, {space.labels[column]}"
                f"{hint}"
            )
        cov[:, row, column] = cov[:, column, row] = _known(values)
    if table.ned & set(spec.covariance or ()):
        turn = _ned_to_enu(space, name, table)
        absent = cov[:, :1, :1] == NO_READING  # which stands first in any frame
        cov = np.where(absent, cov, turn @ cov @ turn.T)
    return cov


def _ned_to_enu(space: Space, name: str, table: Table) -> Float[np.ndarray, "m m"]:
    """What turns a measurement's errors from NED to ENU: each row has one 1 or -1.

    Raises:
        DataError: a component is an attitude's, or has none to change places with.
    """
    turn = np.zeros((space.size, space.size))
    for at, (label, unit) in enumerate(zip(space.labels, space.units, strict=True)):
        inside, sign = axis_in_enu(table.path, label, unit)
        if inside not in space.labels:
            raise DataError(
                f"{table.path}: sensors.{name}.covariance: {label} of frame 'ned' is {inside} "
                f"inside, which is not measured; write the log in 'enu'"
            )
        turn[space.labels.index(inside), at] = sign
    return turn


def _known(values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Zero where nothing is written."""
    return np.where(np.isnan(values), 0.0, values)
