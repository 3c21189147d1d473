"""Chosen components of a vector in the state, each with the same noise."""

import functools as ft
from typing import Annotated, Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor
from kedge.core.errors import ContractError
from kedge.core.manifolds import Euclidean, space_of
from kedge.core.quantities import Scalar
from kedge.core.registry import sensors

DEFAULT_SIZE = 40


@ft.cache
def _vector(kind: str, field: str, size: int, unit: str) -> Any:
    chart = Annotated[Float[Array, str(size)], Euclidean(unit, (size,))]
    return NamedTuple(kind, [(field, chart)])


class _Layout:
    """A layout that depends on the sensor's size; asked of the class, that of the defaults."""

    def __init__(self, kind: str):
        self.kind = kind

    def __get__(self, sensor: Any, cls: type) -> Any:
        if sensor is None:
            return _vector(self.kind, "values", DEFAULT_SIZE, "1")
        size = sensor.size if self.kind == "Reads" else len(sensor.chosen)
        return _vector(self.kind, sensor.field, size, sensor.unit)


@sensors.add("components")
class Components(AbstractSensor[Any]):
    r"""Some components of the state's vector ``field``, each with noise of the same ``std``.

    $z_j = x_{i_j} + v_j$ for the components $i_1, i_2, \ldots$ that are ``chosen``.

    ``size`` is that of the whole vector and ``unit`` its unit; they must be those of the
    state. The components are every ``stride``-th from ``first`` on, or those listed in
    ``indices``, counted from 0. Distances are steps between components, the shorter way round
    where the vector is a ``ring``; other fields of the state have no place (NaN), and filters
    that localise let everything act on them.

    Source: G. Evensen, "The ensemble Kalman filter: theoretical formulation and practical
    implementation", Ocean Dynamics 53, 2003 (a linear operator that picks components).
    """

    reads: ClassVar[Any] = _Layout("Reads")
    measures: ClassVar[Any] = _Layout("Measurement")
    field: str = eqx.field(static=True, default="values")
    size: int = eqx.field(static=True, default=DEFAULT_SIZE)
    unit: str = eqx.field(static=True, default="1")
    first: int = eqx.field(static=True, default=0)
    stride: int = eqx.field(static=True, default=1)
    indices: tuple[int, ...] = eqx.field(static=True, default=())
    ring: bool = eqx.field(static=True, default=True)
    std: Scalar = 1.0

    def __check_init__(self):
        if self.size < 1 or self.stride < 1:
            raise ContractError(
                f"components: size is {self.size} and stride {self.stride}, "
                "both must be at least 1"
            )
        if not self.chosen or not all(0 <= i < self.size for i in self.chosen):
            chosen = f"indices {self.indices}" if self.indices else f"first {self.first}"
            raise ContractError(
                f"components: {chosen}, must be at least 0 and below the size, {self.size}"
            )

    @property
    def chosen(self) -> tuple[int, ...]:
        """The components that are measured, counted from 0."""
        return self.indices or tuple(range(self.first, self.size, self.stride))

    def observe(self, state: Any) -> Any:
        return self.measures(jnp.asarray(state[0])[np.asarray(self.chosen)])

    def noise_std(self, state: Any) -> Any:
        return self.measures(jnp.full(len(self.chosen), self.std))

    def distances(self, state: Any) -> Float[np.ndarray, "m n"]:
        steps = np.abs(np.subtract.outer(np.asarray(self.chosen), np.arange(self.size)))
        steps = np.minimum(steps, self.size - steps) if self.ring else steps
        states = space_of(type(state))
        distances = np.full((len(self.chosen), states.size), np.nan)
        distances[:, states.slices()[self.field]] = steps
        return distances
