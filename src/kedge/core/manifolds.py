"""Charts: how each kind of quantity is perturbed and compared.

Every state, control and measurement is a ``NamedTuple`` whose fields are annotated with a
chart (see :mod:`kedge.core.quantities`). A :class:`Space` is the product of those charts.
Filters only ever call :meth:`Space.boxplus` and :meth:`Space.boxminus`, so angle wrapping
and quaternion algebra happen here and nowhere else.

Source: C. Hertzberg et al., "Integrating generic sensor fusion algorithms with sound state
representations through encapsulation of manifolds", Information Fusion 14(1), 2013.
"""

import functools as ft
from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    Protocol,
    get_type_hints,
    runtime_checkable,
)

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Shaped
from typing_extensions import TypeVar

from kedge.core import rotations
from kedge.core.errors import ContractError
from kedge.core.rotations import wrap

S = TypeVar("S", bound=tuple[Any, ...], default=Any)
if TYPE_CHECKING:
    Point = Array
else:
    Point = Shaped[ArrayLike, "..."]


@runtime_checkable
class Chart(Protocol):
    """One quantity: its unit, its sizes and its two manifold operations."""

    @property
    def unit(self) -> str: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def tangent_shape(self) -> tuple[int, ...]: ...
    @property
    def size(self) -> int: ...

    def boxplus(self, point: Point, delta: Float[Array, " n"]) -> Array: ...
    def boxminus(self, point: Point, base: Point) -> Float[Array, " n"]: ...
    def complete(self, point: Point) -> tuple[Array, Bool[Array, " n"]]:
        """Fill what is missing (NaN) with the origin; say which components are there."""
        ...


@dataclass(frozen=True)
class Euclidean:
    """A scalar (``shape=()``) or vector that adds and subtracts componentwise."""

    unit: str
    shape: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Dimension of the tangent space."""
        return self.shape[0] if self.shape else 1

    @property
    def tangent_shape(self) -> tuple[int, ...]:
        """Shape of a tangent value as authors write it."""
        return self.shape

    def boxplus(self, point: Point, delta: Float[Array, " n"]) -> Array:
        """Add."""
        return point + delta.reshape(self.shape)

    def boxminus(self, point: Point, base: Point) -> Float[Array, " n"]:
        """Subtract."""
        return jnp.reshape(jnp.asarray(point - base), (self.size,))

    def complete(self, point: Point) -> tuple[Array, Bool[Array, " n"]]:
        """Missing components become 0."""
        present = ~jnp.isnan(point)
        return jnp.where(present, point, 0.0), present.reshape(self.size)


@dataclass(frozen=True)
class Circle:
    """An angle. Differences lie in [-pi, pi)."""

    unit: str = "rad"
    shape: tuple[int, ...] = ()
    tangent_shape: tuple[int, ...] = ()
    size: int = 1

    def boxplus(self, point: Point, delta: Float[Array, " n"]) -> Array:
        """Add and wrap."""
        return wrap(point + delta[0])

    def boxminus(self, point: Point, base: Point) -> Float[Array, " n"]:
        """Subtract and wrap."""
        return wrap(point - base)[None]

    def complete(self, point: Point) -> tuple[Array, Bool[Array, " n"]]:
        """A missing angle becomes 0."""
        present = ~jnp.isnan(point)
        return jnp.where(present, point, 0.0), present[None]


@dataclass(frozen=True)
class Rotation:
    """A unit quaternion (w, x, y, z) from body to map; perturbed on the body side."""

    unit: str = "rad"
    shape: tuple[int, ...] = (4,)
    tangent_shape: tuple[int, ...] = (3,)
    size: int = 3

    def boxplus(self, point: Point, delta: Float[Array, " n"]) -> Array:
        r"""$q \otimes \exp(\delta)$, normalised."""
        turned = rotations.multiply(jnp.asarray(point), rotations.exp(delta))
        return turned / jnp.linalg.norm(turned)

    def slope(self, delta: Float[Array, " n"]) -> Float[Array, "n n"]:
        r"""Of $(q \boxplus (\delta + e)) \boxminus (q \boxplus \delta)$ by e, at 0."""
        return rotations.exp_slope(delta)

    def boxminus(self, point: Point, base: Point) -> Float[Array, " n"]:
        r"""$\log(q_0^{-1} \otimes q)$."""
        inverse = rotations.conjugate(jnp.asarray(base))
        return rotations.log(rotations.multiply(inverse, jnp.asarray(point)))

    def complete(self, point: Point) -> tuple[Array, Bool[Array, " n"]]:
        """An attitude is there as a whole or not at all: then it becomes the identity."""
        present = ~jnp.isnan(jnp.asarray(point)).any()
        identity = jnp.array([1.0, 0.0, 0.0, 0.0])
        return jnp.where(present, point, identity), jnp.broadcast_to(present, (3,))


@dataclass(frozen=True)
class Space(Generic[S]):
    """The product manifold of a ``NamedTuple`` of charted quantities."""

    cls: Any
    charts: tuple[Chart, ...]

    @property
    def size(self) -> int:
        """Dimension of the tangent space, which is the size of every covariance."""
        return sum(chart.size for chart in self.charts)

    @property
    def _names(self) -> tuple[str, ...]:
        """The fields'; none where nothing stands, as in the control ``()``."""
        return getattr(self.cls, "_fields", ())

    def zeros(self) -> Float[Array, " n"]:
        """Origin of the tangent space."""
        return jnp.zeros(self.size)

    def boxplus(self, point: S, delta: Float[Array, " n"]) -> S:
        """Move ``point`` by the tangent vector ``delta``."""
        parts = self._split(delta)
        return self.cls(
            *(c.boxplus(p, d) for c, p, d in zip(self.charts, point, parts, strict=True))
        )

    def boxminus(self, point: S, base: S) -> Float[Array, " n"]:
        """Tangent vector that moves ``base`` to ``point``."""
        parts = [c.boxminus(p, b) for c, p, b in zip(self.charts, point, base, strict=True)]
        return jnp.concatenate(parts) if parts else self.zeros()

    def slope(self, delta: Float[Array, " n"]) -> Float[Array, "n n"] | None:
        r"""What a move does to errors: those about $x$ seen about $x \boxplus \delta$.

        $\partial ((x \boxplus (\delta + \epsilon)) \boxminus (x \boxplus \delta)) / \partial
        \epsilon$, from the charts that have a ``slope``; the others are flat. None if all are.

        Source: J. Solà, "Quaternion kinematics for the error-state Kalman filter", 2017,
        arXiv 1711.02508, section 6.3.
        """
        if not any(hasattr(chart, "slope") for chart in self.charts):
            return None
        rows = []
        for chart, part, cut in zip(
            self.charts, self._split(delta), self.slices().values(), strict=True
        ):
            slope: Any = getattr(chart, "slope", None)
            block = jnp.eye(chart.size) if slope is None else slope(part)
            rows.append(jnp.pad(block, ((0, 0), (cut.start, self.size - cut.stop))))
        return jnp.concatenate(rows)

    def flatten(self, tangent: S) -> Float[Array, " n"]:
        """Concatenate a tangent-valued ``NamedTuple`` (a noise, a rate) to a vector."""
        parts = [jnp.ravel(1.0 * jnp.asarray(v)) for v in tangent]
        return jnp.concatenate(parts) if parts else self.zeros()

    def unflatten(self, vector: Float[Array, " n"]) -> S:
        """Undo :meth:`flatten`."""
        parts = self._split(vector)
        shapes = (c.tangent_shape for c in self.charts)
        return self.cls(*(p.reshape(s) for p, s in zip(parts, shapes, strict=True)))

    def complete(self, point: S) -> tuple[S, Bool[Array, " n"]]:
        """Fill missing (NaN) components with the charts' origins; say which are there."""
        filled = [c.complete(p) for c, p in zip(self.charts, point, strict=True)]
        present = [mask for _, mask in filled]
        return self.cls(*(p for p, _ in filled)), jnp.concatenate(
            [jnp.zeros(0, bool), *present]
        )

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each tangent component: ``position_x``, ``heading``."""
        pairs = zip(self._names, self.charts, strict=True)
        return tuple(
            label for name, chart in pairs for label in component_names(name, chart.size)
        )

    @property
    def columns(self) -> dict[str, tuple[str, ...]]:
        """By field, what the columns of its components are called in a file."""
        pairs = zip(self._names, self.charts, strict=True)
        return {name: columns_of(name, chart) for name, chart in pairs}

    @property
    def column_units(self) -> dict[str, str]:
        """By column, its unit in a file; the components of a quaternion have the unit 1."""
        return {
            column: chart.unit if chart.shape == chart.tangent_shape else "1"
            for chart, columns in zip(self.charts, self.columns.values(), strict=True)
            for column in columns
        }

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each tangent component."""
        return tuple(chart.unit for chart in self.charts for _ in range(chart.size))

    def slices(self) -> dict[str, slice]:
        """Where each field's components stand in a tangent vector."""
        slices, start = {}, 0
        for name, chart in zip(self._names, self.charts, strict=True):
            slices[name] = slice(start, start + chart.size)
            start += chart.size
        return slices

    def _split(self, vector: Float[Array, " n"]) -> list[Array]:
        return [vector[cut] for cut in self.slices().values()]


def component_names(field: str, size: int) -> tuple[str, ...]:
    """What the components of a field are called: ``position_x``; a single one, as the field."""
    if size == 1:
        return (field,)
    axes = "xyz" if size <= 3 else map(str, range(size))
    return tuple(f"{field}_{axis}" for _, axis in zip(range(size), axes, strict=False))


def columns_of(field: str, chart: Chart) -> tuple[str, ...]:
    """What the columns of a field of a state, control or measurement are called in a file.

    The names of :func:`component_names`; the four of a quaternion end in ``_w`` to ``_z``.
    """
    if chart.shape != chart.tangent_shape:
        return tuple(f"{field}_{axis}" for axis in "wxyz")
    return component_names(field, chart.size)


AUGMENTED = "augmented"
"""Annotation of a field that a vehicle takes along: biases, scales, the current around it."""


CONSIDERED = "considered"
"""Annotation of a field that no reading corrects, while its spread counts in every update."""


@dataclass(frozen=True)
class Within:
    """Annotation of a field whose values lie in a range, such as a steering angle's.

    ``Annotated[SteeringAngle, Within(-0.6, 0.6)]``. Nothing is clipped: it says where the
    contract checks may try a model.
    """

    low: float
    high: float


@ft.cache
def ranges_of(cls: Any) -> dict[str, Within]:
    """The ranges of those fields of a ``NamedTuple`` that have one."""
    ranges = {}
    for name, hint in get_type_hints(cls, include_extras=True).items():
        for note in getattr(hint, "__metadata__", ()):
            if isinstance(note, Within):
                ranges[name] = note
    return ranges


@ft.cache
def augmented_of(cls: Any) -> tuple[bool, ...]:
    """For each tangent component of a ``NamedTuple``: whether it is marked ``AUGMENTED``."""
    return _marked(cls, AUGMENTED)


@ft.cache
def considered_of(cls: Any) -> tuple[bool, ...]:
    """For each tangent component of a ``NamedTuple``: whether it is marked ``CONSIDERED``."""
    return _marked(cls, CONSIDERED)


def _marked(cls: Any, mark: str) -> tuple[bool, ...]:
    hints = get_type_hints(cls, include_extras=True)
    return tuple(
        mark in getattr(hints[name], "__metadata__", ())
        for name, chart in charts_of(cls).items()
        for _ in range(chart.size)
    )


@ft.cache
def charts_of(cls: Any) -> dict[str, Chart]:
    """Field name to chart, read from the annotations of a ``NamedTuple``.

    Raises:
        ContractError: a field carries no chart.
    """
    charts = {}
    for name, hint in get_type_hints(cls, include_extras=True).items():
        marked = [m for m in getattr(hint, "__metadata__", ()) if hasattr(m, "boxplus")]
        if not marked:
            raise ContractError(
                f"{cls.__module__}.{cls.__qualname__}.{name} has no chart; "
                "annotate it with a quantity from kedge.core.quantities, e.g. Speed"
            )
        charts[name] = marked[0]
    return charts


@ft.cache
def space_of(cls: Any) -> Space:
    """The space of a ``NamedTuple`` class."""
    return Space(cls, tuple(charts_of(cls).values()))


def space(value: Any) -> Space:
    """The space that a state, control, noise or measurement lives in."""
    return space_of(type(value))
