"""The ranges to all anchors at once: one epoch is one reading."""

import functools as ft
from typing import Annotated, Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor, Ranging
from kedge.core.errors import ContractError
from kedge.core.manifolds import Euclidean
from kedge.core.quantities import Metres, Position
from kedge.core.registry import sensors
from kedge.sensors.ranges import CHANCE

CORNERS = ((0.0, 0.0), (0.0, 6.0), (5.0, 0.0), (5.0, 6.0))  # m


class Reads(NamedTuple):
    position: Position


@ft.cache
def _ranges(count: int) -> Any:
    chart = Annotated[Float[Array, str(count)], Euclidean("m", (count,))]
    return NamedTuple("Measurement", [("ranges", chart)])


class _Layout:
    """A measurement of as many ranges as the sensor has anchors."""

    def __get__(self, sensor: Any, cls: type) -> Any:
        return _ranges(len(CORNERS if sensor is None else sensor.anchors))


@sensors.add("range-epoch")
class RangeEpoch(AbstractSensor[Any]):
    r"""Ranges to every anchor in one reading, for a vehicle in the plane.

    $z_i = \sqrt{\lVert p - a_i \rVert^2 + (h - h_i)^2} + \mu_i + v_i$ with
    $v_i \sim N(0, \sigma_i)$.

    Anchors are given by x and y, or by x, y and their height; an anchor that was not heard is
    NaN. ``excess`` (what obstacles add in the mean) and ``stds`` are by anchor, and 0 and
    ``std`` where they are not given.

    Source: J. Qiu, Y. Zhang, M. Tang, P. Ma, J. Ran, "Research on AGV positioning method
    combined with IMU and UWB", Archives of Transport 64(4), 2022, section 2.1.
    """

    reads = Reads
    measures: ClassVar[Any] = _Layout()
    nominal_rate = 1.0
    anchors: tuple[tuple[float, ...], ...] = CORNERS
    std: Metres = 0.05
    stds: tuple[float, ...] = ()
    excess: tuple[float, ...] = ()
    tag_height: Metres = 0.0

    def __check_init__(self):
        sizes = {len(anchor) for anchor in self.anchors}
        if len(self.anchors) < 1 or sizes not in ({2}, {3}):
            raise ContractError(
                f"range-epoch: anchors have {sorted(sizes)} coordinates, expected all of them "
                "to have 2, or 3 with the height"
            )
        for name in ("stds", "excess"):
            count = len(getattr(self, name))
            if count not in (0, len(self.anchors)):
                raise ContractError(
                    f"range-epoch: {name} has {count} numbers, expected one for each of the "
                    f"{len(self.anchors)} anchors, or none"
                )

    def observe(self, state: Reads) -> Any:
        ranging = self.ranging(state)
        away = state.position[None] - ranging.anchors
        distance = jnp.sqrt(jnp.sum(away**2, axis=1) + ranging.rise**2 + 1e-18)
        return self.measures(distance + ranging.excess)

    def noise_std(self, state: Reads) -> Any:
        if self.stds:
            return self.measures(jnp.stack([jnp.asarray(std) for std in self.stds]))
        return self.measures(jnp.full(len(self.anchors), self.std))

    def possible(self, state: Any, measurement: Any) -> Any:
        """Whether every range that was heard is positive and, but for noise, long enough."""
        ranging, ranges = self.ranging(self.project(state)), measurement.ranges
        noise = self.noise_std(self.project(state)).ranges
        least = jnp.abs(ranging.rise) + jnp.minimum(ranging.excess, 0.0) - CHANCE * noise
        return jnp.all(jnp.isnan(ranges) | ((ranges > 0) & (ranges >= least)))

    def ranging(self, state: Reads) -> Ranging:
        places = jnp.stack([jnp.stack([jnp.asarray(x) for x in a]) for a in self.anchors])
        count = places.shape[0]
        none = jnp.zeros(count)
        excess = none
        if self.excess:
            excess = jnp.stack([jnp.asarray(mean) for mean in self.excess])
        rise = none
        if places.shape[1] == 3:
            rise = self.tag_height - places[:, 2]
        present = jnp.asarray(np.ones(count, bool))
        return Ranging(places[:, :2], jnp.ones(count), none, excess, rise, present)
