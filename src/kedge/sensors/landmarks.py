"""Range and bearing to landmarks: one sensor over a map, each reading names its landmark."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Bearing, Heading, Metres, Position, Radians, Range, Ratio
from kedge.core.registry import sensors
from kedge.core.rotations import polar, wrap


class Measurement(NamedTuple):
    range: Range
    bearing: Bearing


class Reads(NamedTuple):
    position: Position
    heading: Heading
    range_scale: Ratio = 1.0
    bearing_bias: Radians = 0.0


class Landmark(NamedTuple):
    position: Position


MAP: Any = np.array([[20.0, 30.0], [-10.0, 5.0], [25.0, -15.0]])  # m, a small example


@sensors.add("landmarks")
class Landmarks(AbstractSensor[Measurement]):
    r"""Range and bearing to the landmarks of a map.

    $z = [s_r \lVert l - p \rVert,\ \angle(l - p) - \psi + b]$, positive to the left.

    The range error has a part that grows with the distance, as a camera's or a radar's does.

    Source: S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics", 2005, section 6.6.2.
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    target: Landmark = Landmark(MAP)
    range_std: Metres = 0.5
    range_std_per_metre: Ratio = 0.0
    bearing_std: Radians = 0.02

    def observe(self, state: Reads) -> Measurement:
        distance, angle = polar(self.target.position - state.position)
        return Measurement(
            range=state.range_scale * distance,
            bearing=wrap(angle - state.heading + state.bearing_bias),
        )

    def noise_std(self, state: Reads) -> Measurement:
        distance, _ = polar(self.target.position - state.position)
        return Measurement(
            range=self.range_std + self.range_std_per_metre * distance,
            bearing=jnp.asarray(self.bearing_std),
        )
