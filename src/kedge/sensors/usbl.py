"""Ultra-short baseline: range and direction of transponders, as the vehicle hears them."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Attitude, Bearing, Metres, Position3, Radians, Range, Ratio
from kedge.core.registry import sensors
from kedge.core.rotations import conjugate, polar, rotate

MAP: Any = np.array([[20.0, -10.0, -30.0]])  # m, of the example
STEEPEST = 0.05
"""Least cosine of the elevation by which the noise of the bearing is divided."""


class Measurement(NamedTuple):
    range: Range
    bearing: Bearing
    elevation: Bearing


class Reads(NamedTuple):
    position: Position3
    attitude: Attitude
    range_scale: Ratio = 1.0


class Transponder(NamedTuple):
    position: Position3


@sensors.add("usbl")
class Usbl(AbstractSensor[Measurement]):
    r"""Range, bearing (to the left of the nose) and elevation (up) of a transponder.

    $z = [s\,\lVert d \rVert,\ \operatorname{atan2}(d_y, d_x),\
    \operatorname{atan2}(d_z, \sqrt{d_x^2 + d_y^2})] + v$ with $d = R^\top (a - p)$

    The scale s (``range_scale``) is that of the sound speed. Directions come from differences
    of phase, so the bearing grows vague with the cosine of the elevation.

    Source: P. Milne, "Underwater Acoustic Positioning Systems", 1983 (ultra-short baseline).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 0.1
    target: Transponder = Transponder(MAP)
    range_std: Metres = 0.1
    range_std_per_metre: Ratio = 0.01
    angle_std: Radians = 0.01

    def observe(self, state: Reads) -> Measurement:
        offset = self._offset(state)
        level, bearing = polar(offset[:2])
        distance, elevation = polar(jnp.stack([level, offset[2]]))
        return Measurement(state.range_scale * distance, bearing, elevation)

    def noise_std(self, state: Reads) -> Measurement:
        offset = self._offset(state)
        level, _ = polar(offset[:2])
        distance, _ = polar(jnp.stack([level, offset[2]]))
        slope = jnp.maximum(level / distance, STEEPEST)
        return Measurement(
            range=self.range_std + self.range_std_per_metre * distance,
            bearing=self.angle_std / slope,
            elevation=jnp.asarray(self.angle_std),
        )

    def _offset(self, state: Reads) -> Float[Array, "3"]:
        """From the head to the transponder, in the head's axes."""
        return rotate(conjugate(state.attitude), self.target.position - state.position)
