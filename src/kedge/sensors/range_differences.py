"""Differences of ranges: how much farther one anchor is than a reference anchor."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Position, Position3, Range
from kedge.core.registry import sensors
from kedge.sensors.ranges import CHANCE

NEAR = 1e-9  # m; keeps slopes finite at an anchor


class Measurement(NamedTuple):
    difference: Range


class Reads(NamedTuple):
    position: Position


class Reads3(NamedTuple):
    position: Position3


class Anchor(NamedTuple):
    position: Any
    """m."""
    reference: Any
    """Place of the anchor that this one's readings are compared with, m."""
    offset: Any = 0.0
    """Known beforehand: what clocks and delays add, m."""


CORNERS: Any = np.array([[30.0, 0.0], [30.0, 20.0], [0.0, 20.0]])
CORNERS3: Any = np.array([[30.0, 0.0, 1.0], [30.0, 20.0, 3.0], [0.0, 20.0, 2.0]])


def _distance(place: Float[Array, " d"], anchor: Float[Array, " d"]) -> Float[Array, ""]:
    away = place - anchor
    return jnp.sqrt(away @ away + NEAR**2)


def _difference(anchor: Anchor, place: Float[Array, " d"]) -> Measurement:
    far = _distance(place, jnp.asarray(anchor.position))
    near = _distance(place, jnp.asarray(anchor.reference))
    return Measurement(far - near + jnp.asarray(anchor.offset))


def _possible(anchor: Anchor, std: Any, measurement: Measurement) -> Any:
    """Whether it is, but for noise, no longer than the way between the two anchors."""
    between = _distance(jnp.asarray(anchor.position), jnp.asarray(anchor.reference))
    distance = jnp.abs(measurement.difference - jnp.asarray(anchor.offset))
    return distance <= between + CHANCE * jnp.asarray(std)


@sensors.add("range-differences")
class RangeDifferences(AbstractSensor[Measurement]):
    r"""Time difference of arrival in the plane, as a length.

    $z = \lVert p - a_j \rVert - \lVert p - a_r \rVert + b_j + v$.

    Readings are taken to err independently, as they do when the anchors of each pair exchange
    the messages of that pair. Where all readings of an epoch share the reference's error, give
    them to :func:`kedge.positioning.differences.differences` together.

    Source: Y. T. Chan, K. C. Ho, "A simple and efficient estimator for hyperbolic location",
    IEEE Transactions on Signal Processing 42(8), 1994.
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    target: Anchor = Anchor(CORNERS, np.zeros((3, 2)), np.zeros(3))
    std: Metres = 0.1

    def observe(self, state: Reads) -> Measurement:
        return _difference(self.target, state.position)

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.asarray(self.std))

    def possible(self, state: Any, measurement: Measurement) -> Any:
        return _possible(self.target, self.std, measurement)


@sensors.add("range-differences3")
class RangeDifferences3(AbstractSensor[Measurement]):
    r"""Time difference of arrival in space, as a length; all else as for ``range-differences``.

    $z = \lVert p - a_j \rVert - \lVert p - a_r \rVert + b_j + v$.

    Source: Y. T. Chan, K. C. Ho, "A simple and efficient estimator for hyperbolic location",
    IEEE Transactions on Signal Processing 42(8), 1994.
    """

    reads = Reads3
    measures = Measurement
    nominal_rate = 10.0
    target: Anchor = Anchor(CORNERS3, np.zeros((3, 3)), np.zeros(3))
    std: Metres = 0.1

    def observe(self, state: Reads3) -> Measurement:
        return _difference(self.target, state.position)

    def noise_std(self, state: Reads3) -> Measurement:
        return Measurement(jnp.asarray(self.std))

    def possible(self, state: Any, measurement: Measurement) -> Any:
        return _possible(self.target, self.std, measurement)
