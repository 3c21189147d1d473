"""What drivers hand to an estimator, checked against its rig before anything is done with it.

A reading or a control of the wrong kind is a mistake of the program and raises. One that is
right in form and not finite is a fault of a sensor, which a verdict answers.
"""

import math
import operator
from typing import Any, NamedTuple

import jax
import numpy as np

from kedge.core.errors import ContractError, DataError
from kedge.core.manifolds import space_of
from kedge.estimation.log import Readings
from kedge.estimation.rig import Rig

FLOAT = jax.dtypes.canonicalize_dtype(float)
NO_TARGET = -1
"""On no map; so are numbers that no integer of the machine holds."""


class Fields(NamedTuple):
    """The form of a ``NamedTuple`` of numbers."""

    of: str
    """Whose they are, for messages."""
    cls: Any
    names: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]
    size: int

    def arrays(self, given: Any) -> Any:
        """The numbers as arrays of one type, whatever a driver has at hand.

        Raises:
            ContractError: it is of another class.
            DataError: a field holds no numbers, or those of another shape.
        """
        if type(given) is not self.cls:
            raise ContractError(
                f"{self.of}: found {type(given).__name__}, expected {_title(self.cls)}"
                f"({', '.join(self.names)})"
            )
        return self.cls(
            *(
                numbers(f"{self.of}: {name}", value, shape)
                for name, value, shape in zip(self.names, given, self.shapes, strict=True)
            )
        )


class Admission:
    """The forms of all that a rig takes in; ``control`` is one as it holds at the start."""

    def __init__(self, rig: Rig, control: Any):
        self._readings = [
            _fields(f"a reading of {one.name!r}", one.sensor.measures) for one in rig.sensors
        ]
        leaves, self._control = jax.tree.flatten(control)
        self._shapes = [np.shape(leaf) for leaf in leaves]
        paths = jax.tree_util.tree_leaves_with_path(control)
        self._names = [jax.tree_util.keystr(path).lstrip(".") for path, _ in paths]
        self._title = f"{_title(type(control))}({', '.join(self._names)})"

    def reading(self, rank: int, measurement: Any, target: Any, cov: Any) -> Readings:
        """One reading of the sensor of that rank.

        Raises:
            ContractError: the measurement is that of another sensor.
            DataError: it, its target or its covariance has another form.
        """
        form = self._readings[rank]
        try:
            number = operator.index(target)
        except TypeError:
            raise DataError(
                f"{form.of}: target is {target!r}, expected its row in the map, a whole number"
            ) from None
        which: Any = np.asarray(number if abs(number) < 2**62 else NO_TARGET)
        spread: Any = None
        if cov is not None:
            spread = numbers(f"{form.of}: the covariance", cov, (form.size, form.size))
        return Readings(form.arrays(measurement), which, spread)

    def control(self, control: Any) -> Any:
        """The control as arrays.

        Raises:
            ContractError: it is that of another vehicle.
            DataError: a part of it holds no numbers, or those of another shape.
        """
        leaves, form = jax.tree.flatten(control)
        if form != self._control:
            given = _title(type(control))
            raise ContractError(f"the control: found {given}, expected {self._title}")
        parts = zip(self._names, leaves, self._shapes, strict=True)
        return form.unflatten([numbers(f"the control: {n}", v, s) for n, v, s in parts])


def seconds(time: Any) -> float:
    """The time of an event.

    Raises:
        DataError: it is no number, or not finite.
    """
    try:
        value = float(time)
    except (TypeError, ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise DataError(f"event time is {time}; expected seconds since the start")
    return value


def is_finite(tree: Any) -> bool:
    """Whether all numbers in it are."""
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))


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


def _fields(of: str, cls: Any) -> Fields:
    space = space_of(cls)
    shapes = tuple(chart.shape for chart in space.charts)
    return Fields(of, cls, getattr(cls, "_fields", ()), shapes, space.size)


def _title(cls: type) -> str:
    module = cls.__module__.rpartition(".")[2]
    return cls.__qualname__ if module == "builtins" else f"{module}.{cls.__qualname__}"
