"""What drivers hand to an estimator, checked against its rig before anything is done with it.

A reading or a control of the wrong kind is a mistake of the program and raises. One that is
right in form and not finite is a fault of a sensor, which a verdict answers.
"""

import math
import operator
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from kedge.core.errors import ContractError, DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.delayed import Order
from kedge.estimation.log import SECOND
from kedge.estimation.rig import Rig
from kedge.estimation.rows import HAS_CONTROL, HAS_COV, NO_SENSOR, EventForm, Part

FLOAT = jax.dtypes.canonicalize_dtype(float)
IS_WIDE = FLOAT == np.float64
NS = 1 / SECOND
MOST_NS = 2**62
"""146 years: no clock of a vehicle runs so long."""
NO_TARGET = -1
"""On no map; so are numbers that no integer of the machine holds."""


FUSED, NONE, NOT_FINITE = map(int, (Verdict.FUSED, Verdict.NONE, Verdict.NOT_FINITE))
Admitted = tuple[Order, np.ndarray | None, int]
"""An event's order, the control that will hold, and the verdict on the control that came."""


class Admission:
    """The forms of all that a rig takes in, written into the first row of ``rows``."""

    def __init__(self, rig: Rig, form: EventForm, rows: np.ndarray, control: Any, unit: float):
        self._form, self._rig, self._unit = form, rig, unit
        self._measurement, self._cov, self._control = (
            rows[name][0] for name in ("measurement", "cov", "control")
        )
        self._sensor, self._target, self._sequence, self._has_cov, self._has_control = (
            rows[name] for name in ("sensor", "target", "sequence", "has_cov", "has_control")
        )
        self._ranks = {name: rank for rank, name in enumerate(rig.names)}
        self._tails = [
            slice(size, None) if size < len(self._measurement) else None
            for size in form.sizes_read
        ]
        self._structure = jax.tree.structure(control)
        # A control that is a tuple of numbers and arrays need not be taken apart.
        is_flat = len(getattr(type(control), "_fields", ())) == len(form.controls)
        self._class = type(control) if is_flat else None
        names = ", ".join(part.name for part in form.controls)
        self._title = f"{_title(type(control))}({names})"

    def event(
        self, time: Any, sensor: Any, measurement: Any, control: Any, target: Any, cov: Any,
        sequence: int,
    ) -> Admitted:  # fmt: skip
        """A whole event, but for what is known of those before it.

        Raises:
            DataError: a part of it has another form.
            ContractError: it is of another rig.
        """
        at = nanoseconds(time, self._unit)
        rank, place = (len(self._ranks) if control is None else -1), NO_SENSOR
        if sensor is not None:
            known = self._ranks.get(sensor)
            rank = place = self._rig.index(sensor) if known is None else known
            self.reading(rank, measurement, target, cov)
        else:
            self._has_cov[0] = 0
        held, fate = None, NONE
        if control is not None:
            held = self.control(control)
            fate = FUSED if held is not None else NOT_FINITE
        self._sensor[0], self._has_control[0] = place, held is not None
        self._sequence[0] = sequence
        return (at, rank, sequence), held, fate

    def reading(self, rank: int, measurement: Any, target: Any, cov: Any) -> None:
        """One reading of the sensor of that rank.

        Raises:
            ContractError: the measurement is that of another sensor.
            DataError: it, its target or its covariance has another form.
        """
        form = self._form
        if type(measurement) is not form.measures[rank]:
            names = ", ".join(part.name for part in form.readings[rank])
            raise ContractError(
                f"{self._whose(rank)}: found {type(measurement).__name__}, expected "
                f"{_title(form.measures[rank])}({names})"
            )
        try:
            number = operator.index(target)
        except TypeError:
            raise DataError(
                f"{self._whose(rank)}: target is {target!r}, expected its row in the map, a "
                "whole number"
            ) from None
        self._target[0] = number if -(2**62) < number < 2**62 else NO_TARGET
        if (tail := self._tails[rank]) is not None:
            self._measurement[tail] = 0.0  # else what comes twice is not the same
        write(lambda: self._whose(rank), measurement, form.readings[rank], self._measurement)
        self._has_cov[0] = cov is not None
        if cov is not None:
            size = form.sizes[rank]
            spread = numbers(f"{self._whose(rank)}: the covariance", cov, (size, size))
            self._cov[: size * size], self._cov[size * size :] = spread.ravel(), 0.0

    def control(self, control: Any) -> np.ndarray | None:
        """The control as a vector, or None if it is not finite.

        Raises:
            ContractError: it is that of another vehicle.
            DataError: a part of it holds no numbers, or those of another shape.
        """
        leaves = control
        if type(control) is not self._class:
            leaves, structure = jax.tree.flatten(control)
            if structure != self._structure:
                given = _title(type(control))
                raise ContractError(f"the control: found {given}, expected {self._title}")
        write(lambda: "the control", leaves, self._form.controls, self._control)
        if all(map(math.isfinite, self._control.tolist())):
            return self._control.copy()
        return None

    def checked(self, words: np.ndarray) -> list[Admitted]:
        """Words of rows from outside; a control that is not finite is taken out of them.

        Raises:
            DataError: a sensor is not of this rig.
        """
        heads = words[:, : HAS_COV + 1].tolist()
        count, admitted = len(self._ranks), []
        for row, (time, turn, rank, brings, spread) in zip(words, heads, strict=True):
            if not NO_SENSOR <= rank < count:
                raise DataError(
                    f"push_many: sensor: found {rank}, expected {NO_SENSOR} to {count - 1}"
                )
            if spread and rank == NO_SENSOR:
                row[HAS_COV] = 0
            held, fate, place = None, NONE, rank if rank >= 0 else -1 if brings else count
            if brings:
                held = row[self._form.words["control"]].view(float).copy()
                fate = FUSED if all(map(math.isfinite, held.tolist())) else NOT_FINITE
                held = held if fate == FUSED else None
                row[HAS_CONTROL] = fate == FUSED
            admitted.append(((time, place, turn), held, fate))
        return admitted

    def _whose(self, rank: int) -> str:
        return f"a reading of {self._rig.names[rank]!r}"


def write(
    of: Callable[[], str], values: Any, laid: tuple[Part, ...], vector: np.ndarray
) -> None:
    """Put values into a vector, whatever a driver has at hand.

    Raises:
        DataError: one holds no numbers, or those of another shape.
    """
    for value, (name, shape, place) in zip(values, laid, strict=True):
        if not shape and type(value) is float and IS_WIDE:
            vector[place.start] = value
        elif type(value) is np.ndarray and value.dtype is FLOAT and value.shape == shape:
            vector[place] = value if len(shape) == 1 else value.ravel()
        else:
            vector[place] = numbers(f"{of()}: {name}", value, shape).ravel()


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
        hint = " (whole nanoseconds with clock='ns')" if value > MOST_NS and unit != NS else ""
        raise DataError(f"event time is {time}; expected {what} since the start{hint}")
    return value


def numbers(what: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """An array of floats.

    Raises:
        DataError: it holds no real numbers, or those of another shape.
    """
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
