"""Ranges to the anchors of a map: one sensor over the map, each reading names its anchor."""

import functools as ft
import keyword
import types
from typing import Annotated, Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor, Ranging
from kedge.core.errors import ContractError
from kedge.core.manifolds import Euclidean
from kedge.core.quantities import Metres, Position, Position3, Range, Ratio
from kedge.core.registry import sensors

CHANCE = 5.0  # standard deviations by which noise may shorten a range
SHORTEST = 1e-9  # m; at the anchor itself a direction is made up, so that slopes stay finite


class Measurement(NamedTuple):
    range: Range


class Reads(NamedTuple):
    position: Position
    range_scale: Ratio = 1.0
    range_bias: Metres = 0.0


class Reads3(NamedTuple):
    position: Position3
    range_scale: Ratio = 1.0
    range_bias: Metres = 0.0


class Anchor(NamedTuple):
    position: Any
    """m; with two components in the plane, with three in space."""
    position_z: Any = 0.0
    """m; height of an anchor whose position has two components."""
    offset: Any = 0.0
    """m by which its ranges are too long, known beforehand."""
    scale: Any = 1.0
    """By which its ranges are multiplied, known beforehand."""
    std: Any = 0.0
    """m; its own noise, 0 for that of the sensor."""
    own: Any = None
    """Row of the identity: which of the estimated biases is its own."""


def complete(anchor: Anchor) -> Anchor:
    """One value for all becomes one for each; each gets its row of the identity."""
    if anchor.own is not None:
        return anchor
    count = len(anchor.position)
    each = (
        np.broadcast_to(value, count) if np.ndim(value) == 0 else value for value in anchor[1:5]
    )
    return Anchor(anchor.position, *each, own=np.eye(count))


class _Layout:
    """What a sensor reads: with a bias for each anchor of its own map."""

    def __init__(self, plain: Any):
        self.plain = plain

    def __get__(self, sensor: Any, cls: type) -> Any:
        if sensor is None or not sensor.biases:
            return self.plain
        return _with_biases(self.plain, sensor.biases, sensor.target.own.shape[-1])


@ft.cache
def _with_biases(plain: Any, name: str, count: int) -> Any:
    if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
        raise ContractError(
            f"biases: found {name!r}, expected the name of a field: letters, digits and _"
        )
    chart = Annotated[Float[Array, str(count)], Euclidean("m", (count,))]
    fields = {**plain.__annotations__, name: chart}
    body = {
        "__module__": plain.__module__,
        "__annotations__": fields,
        **plain._field_defaults,
        name: np.zeros(count),
    }
    return types.new_class(
        plain.__name__, (NamedTuple,), exec_body=lambda namespace: namespace.update(body)
    )


def _example(height: float | None) -> Any:
    corners = [[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]]
    if height is None:
        return np.array(corners)
    return np.array([[*corner, height + index % 2] for index, corner in enumerate(corners)])


def _between(offset: Array) -> Float[Array, ""]:
    """Length of a vector; its derivatives are finite at 0."""
    squared = offset @ offset
    at_anchor = squared < SHORTEST**2
    made_up = SHORTEST + 0.0 * offset[0]
    return jnp.where(at_anchor, made_up, jnp.sqrt(jnp.where(at_anchor, 1.0, squared)))


def _range(sensor: Any, state: Any, distance: Float[Array, ""]) -> Measurement:
    """What a radio makes of a distance."""
    anchor = sensor.target
    anchor_bias = anchor.own @ getattr(state, sensor.biases) if sensor.biases else 0.0
    scale = anchor.scale * state.range_scale
    return Measurement(scale * distance + anchor.offset + state.range_bias + anchor_bias)


def _told(sensor: Any, state: Any, rise: Float[Array, ""]) -> Ranging:
    """The range as what a position can be found from."""
    anchor = sensor.target
    anchor_bias = anchor.own @ getattr(state, sensor.biases) if sensor.biases else 0.0
    scale = jnp.asarray(anchor.scale * state.range_scale)
    bias = jnp.asarray(anchor.offset + state.range_bias + anchor_bias)
    place = jnp.asarray(anchor.position)
    none = jnp.zeros(1)
    return Ranging(place[None], scale[None], bias[None], none, rise[None], jnp.ones(1, bool))


def _std(sensor: Any, distance: Float[Array, ""]) -> Measurement:
    """Its noise: the anchor's own where the map has one, else the sensor's."""
    individual = jnp.asarray(sensor.target.std)
    common = sensor.range_std + sensor.range_std_per_metre * distance
    return Measurement(jnp.where(individual > 0, individual, common))


def _possible(sensor: Any, state: Any, measurement: Measurement, rise: Any) -> Any:
    """Whether a range is positive and, but for noise, no shorter than the least distance."""
    least = jnp.abs(rise)
    expected = _range(sensor, sensor.project(state), least).range
    noise = _std(sensor, least).range
    return (measurement.range > 0) & (measurement.range >= expected - CHANCE * noise)


@sensors.add("ranges")
class Ranges(AbstractSensor[Measurement]):
    r"""Range to anchors for a vehicle in the plane; the heights of tag and anchors are known.

    $z = s\,s_i \sqrt{\lVert p - a_i \rVert^2 + (h - h_i)^2} + b_i + b + v$

    with the anchor's own scale and offset from the map (columns ``scale``, ``offset``), and a
    common scale and bias that can be estimated with the state (``range_scale``,
    ``range_bias``). ``biases`` names a vector of further biases, one for each anchor of the
    map, to be estimated too: two sensors may share it, or have one each. The map gives the
    position (``position_x``, ``position_y``) and, where they are known, the heights
    (``position_z``), and a noise ``std`` of an anchor's own.

    Source: A. Sayed, A. Tarighat, N. Khajehnouri, "Network-based wireless location:
    challenges faced in developing techniques for accurate wireless location information", IEEE
    Signal Processing Magazine 22(4), 2005, section on time of arrival.
    """

    reads: ClassVar[Any] = _Layout(Reads)
    measures = Measurement
    nominal_rate = 10.0
    positive = ("range",)
    target: Anchor = eqx.field(converter=complete, default=Anchor(_example(None)))
    range_std: Metres = 0.1
    range_std_per_metre: Ratio = 0.0
    tag_height: Metres = 0.0
    biases: str = eqx.field(static=True, default="")

    def observe(self, state: Any) -> Measurement:
        return _range(self, state, self._distance(state))

    def noise_std(self, state: Any) -> Measurement:
        return _std(self, self._distance(state))

    def possible(self, state: Any, measurement: Measurement) -> Any:
        rise = jnp.asarray(self.tag_height - self.target.position_z)
        return _possible(self, state, measurement, rise)

    def ranging(self, state: Any) -> Ranging:
        rise = jnp.asarray(self.tag_height - self.target.position_z)
        return _told(self, state, rise)

    def _distance(self, state: Any) -> Float[Array, ""]:
        rise = jnp.asarray(self.tag_height - self.target.position_z)
        return _between(jnp.append(state.position - self.target.position, rise))


@sensors.add("ranges3")
class Ranges3(AbstractSensor[Measurement]):
    r"""Range to anchors for a vehicle in space; a lever arm of the tag is its mount.

    $z = s\,s_i \lVert p - a_i \rVert + b_i + b + v$, all else as for ``ranges``.

    Source: A. Sayed, A. Tarighat, N. Khajehnouri, "Network-based wireless location:
    challenges faced in developing techniques for accurate wireless location information", IEEE
    Signal Processing Magazine 22(4), 2005, section on time of arrival.
    """

    reads: ClassVar[Any] = _Layout(Reads3)
    measures = Measurement
    nominal_rate = 10.0
    positive = ("range",)
    target: Anchor = eqx.field(converter=complete, default=Anchor(_example(2.0)))
    range_std: Metres = 0.1
    range_std_per_metre: Ratio = 0.0
    biases: str = eqx.field(static=True, default="")

    def observe(self, state: Any) -> Measurement:
        return _range(self, state, self._distance(state))

    def noise_std(self, state: Any) -> Measurement:
        return _std(self, self._distance(state))

    def possible(self, state: Any, measurement: Measurement) -> Any:
        return _possible(self, state, measurement, jnp.zeros(()))

    def ranging(self, state: Any) -> Ranging:
        return _told(self, state, jnp.zeros(()))

    def _distance(self, state: Any) -> Float[Array, ""]:
        return _between(state.position - self.target.position)
