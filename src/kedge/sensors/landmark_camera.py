"""A camera that recognises landmarks of known size: depth along its axis, and bearing."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Bearing, Heading, Metres, Position, Radians, Range, Ratio
from kedge.core.registry import sensors
from kedge.core.rotations import polar, wrap
from kedge.sensors.landmarks import MAP, Landmark


class Measurement(NamedTuple):
    depth: Range
    bearing: Bearing


class Reads(NamedTuple):
    position: Position
    heading: Heading
    depth_scale: Ratio = 1.0
    bearing_bias: Radians = 0.0


@sensors.add("landmark-camera")
class LandmarkCamera(AbstractSensor[Measurement]):
    r"""Depth and bearing of landmarks of known size, as a camera sees them.

    $z = [s\, r \cos\beta,\ \beta + b]$ at distance r and bearing $\beta$ from the nose.

    The apparent size of a landmark gives its depth $r \cos\beta$ along the optical axis, not
    its distance: 30 degrees off the axis the two differ by 13 %. Some data sets (MRCLAM) call
    the depth a range.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry in Computer Vision", 2nd ed.,
    2004, section 6.1 (the pinhole camera).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    target: Landmark = Landmark(MAP)
    depth_std: Metres = 0.03
    depth_std_per_metre: Ratio = 0.03
    bearing_std: Radians = 0.02
    widest: Radians = 1.37
    """Beyond it the depth is held: no camera sees there, but a filter may look."""

    def observe(self, state: Reads) -> Measurement:
        distance, angle = polar(self.target.position - state.position)
        bearing = wrap(angle - state.heading)
        ahead = jnp.maximum(jnp.cos(bearing), jnp.cos(self.widest))
        return Measurement(
            depth=state.depth_scale * distance * ahead,
            bearing=wrap(bearing + state.bearing_bias),
        )

    def noise_std(self, state: Reads) -> Measurement:
        distance, _ = polar(self.target.position - state.position)
        return Measurement(
            depth=self.depth_std + self.depth_std_per_metre * distance,
            bearing=jnp.asarray(self.bearing_std),
        )
