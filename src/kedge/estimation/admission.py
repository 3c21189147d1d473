"""What drivers hand to an estimator, checked against its rig before anything is done with it.

A reading or a control of the wrong kind is a mistake of the program and raises. One that is
right in form and not finite is a fault of a sensor, which a verdict answers.
"""

import math
import operator
from typing import Any

import jax
import numpy as np

from kedge.core.errors import ContractError, DataError
from kedge.estimation.log import SECOND
from kedge.estimation.rig import Rig
from kedge.estimation.rows import EventForm, Part

FLOAT = jax.dtypes.canonicalize_dtype(float)
IS_WIDE = FLOAT == np.float64
NS = 1 / SECOND
MOST_NS = 2**62
"""146 years: no clock of a vehicle runs so long."""
NO_TARGET = -1
"""On no map; so are numbers that no integer of the machine holds."""


class Admission:
    """The forms of all that a rig takes in, written into the first of ``rows``."""

    def __init__(self, rig: Rig, form: EventForm, rows: np.ndarray, control: Any):
        self._form = form
        self._measurement, self._cov, self._control = (
            rows[name][0] for name in ("measurement", "cov", "control")
        )
        self._target, self._has_cov = rows["target"], rows["has_cov"]
        self._whose = [f"a reading of {one.name!r}" for one in rig.sensors]
        self._structure = jax.tree.structure(control)
        names = ", ".join(part.name for part in form.controls)
        self._title = f"{_title(type(control))}({names})"

    def reading(self, rank: int, measurement: Any, target: Any, cov: Any) -> None:
        """One reading of the sensor of that rank.

        Raises:
            ContractError: the measurement is that of another sensor.
            DataError: it, its target or its covariance has another form.
        """
        form, of = self._form, self._whose[rank]
        if type(measurement) is not form.measures[rank]:
            names = ", ".join(part.name for part in form.readings[rank])
            raise ContractError(
                f"{of}: found {type(measurement).__name__}, expected "
                f"{_title(form.measures[rank])}({names})"
            )
        try:
            number = operator.index(target)
        except TypeError:
            raise DataError(
                f"{of}: target is {target!r}, expected its row in the map, a whole number"
            ) from None
        self._target[0] = number if -(2**62) < number < 2**62 else NO_TARGET
        size = form.sizes_told[rank]
        self._measurement[size:] = 0.0  # else what is said twice is not the same
        write(of, measurement, form.readings[rank], self._measurement)
        self._has_cov[0] = cov is not None
        if cov is not None:
            size = form.sizes[rank]
            spread = numbers(f"{of}: the covariance", cov, (size, size))
            self._cov[: size * size], self._cov[size * size :] = spread.ravel(), 0.0

    def control(self, control: Any) -> np.ndarray | None:
        """The control as a vector, or None if it is not finite.

        Raises:
            ContractError: it is that of another vehicle.
            DataError: a part of it holds no numbers, or those of another shape.
        """
        leaves, structure = jax.tree.flatten(control)
        if structure != self._structure:
            given = _title(type(control))
            raise ContractError(f"the control: found {given}, expected {self._title}")
        write("the control", leaves, self._form.controls, self._control)
        if all(map(math.isfinite, self._control.tolist())):
            return self._control.copy()
        return None


def write(of: str, values: Any, laid: tuple[Part, ...], vector: np.ndarray) -> None:
    """Put values into a vector, whatever a driver has at hand.

    Raises:
        DataError: one holds no numbers, or those of another shape.
    """
    for value, (name, shape, place) in zip(values, laid, strict=True):
        if type(value) is float and not shape and IS_WIDE:
            vector[place.start] = value
        else:
            vector[place] = numbers(f"{of}: {name}", value, shape).ravel()


def nanoseconds(time: Any, unit: float) -> int:
    """The time of an event in ns, from a clock that counts in ``unit`` seconds.

    Raises:
        DataError: it is no number, or not finite, or beyond all clocks.
    """
    try:
        value = operator.index(time) if unit == NS else round(float(time) * SECOND)
    except (TypeError, ValueError, OverflowError):
        value = MOST_NS
    if not -MOST_NS < value < MOST_NS:
        what = "whole nanoseconds" if unit == NS else "seconds"
        raise DataError(f"event time is {time}; expected {what} since the start")
    return value


def numbers(what: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """An array of floats.

    Raises:
        DataError: it holds no real numbers, or those of another shape.
    """
    if type(value) is np.ndarray and value.dtype == FLOAT and value.shape == shape:
        return value
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # ragged
        array = np.asarray(None)
    if array.dtype.kind not in "fiub":
        found = type(value).__name__ if array.ndim == 0 else f"{array.dtype.name} numbers"
        raise DataError(f"{what}: found {found}, expected {_shaped(shape)}")
    if array.shape != shape:
        raise DataError(f"{what}: found {_shaped(array.shape)}, expected {_shaped(shape)}")
    return np.asarray(array, FLOAT)


def _shaped(shape: tuple[int, ...]) -> str:
    if not shape:
        return "one number"
    return f"{' x '.join(map(str, shape))} numbers"


def _title(cls: type) -> str:
    module = cls.__module__.rpartition(".")[2]
    return cls.__qualname__ if module == "builtins" else f"{module}.{cls.__qualname__}"
