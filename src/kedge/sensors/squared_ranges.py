"""Squared ranges to the anchors of a map: quadratic in the position, noisier far away."""

from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.manifolds import Euclidean
from kedge.core.quantities import Metres, Position, Scalar
from kedge.core.registry import sensors
from kedge.sensors.ranges import CHANCE, Anchor, Ranges, complete

SquaredRange = Annotated[Scalar, Euclidean("m^2")]


class Measurement(NamedTuple):
    squared_range: SquaredRange


class Reads(NamedTuple):
    position: Position


@sensors.add("squared-ranges")
class SquaredRanges(AbstractSensor[Measurement]):
    r"""The square of a range $D = d + v$ with $v \sim N(0, \sigma^2)$, in the plane.

    $z = D^2$ has the mean $d^2 + \sigma^2$ and the variance $4 d^2 \sigma^2 + 2 \sigma^4$. It
    is exactly quadratic in the position and has no singular point, not even the anchor; what
    it costs is a noise that is not normal there and depends on the distance. ``ranges`` has
    neither. With ``squared_std`` that noise is a constant instead, as filters of the
    literature have it. Offsets and scales of anchors are not for it.

    Source: A. Beck, P. Stoica, J. Li, "Exact and approximate solutions of source localization
    problems", IEEE Trans. Signal Processing 56(5), 2008, section 2 (squared ranges).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    target: Anchor = eqx.field(converter=complete, default_factory=lambda: Ranges().target)
    range_std: Metres = 0.1
    squared_std: Scalar = 0.0  # m^2; 0 for what follows from range_std
    tag_height: Metres = 0.0

    def observe(self, state: Reads) -> Measurement:
        return Measurement(self._squared(state) + self.range_std**2)

    def noise_std(self, state: Reads) -> Measurement:
        variance = jnp.asarray(self.range_std) ** 2
        exact = jnp.sqrt(4 * self._squared(state) * variance + 2 * variance**2)
        return Measurement(jnp.where(self.squared_std > 0, self.squared_std, exact))

    def possible(self, state: Any, measurement: Measurement) -> Any:
        """Whether it is a square, and no smaller than that of the height but for noise."""
        above = Reads(jnp.asarray(self.target.position))
        least, noise = self.observe(above).squared_range, self.noise_std(above).squared_range
        measured = measurement.squared_range
        return (measured > 0) & (measured >= least - CHANCE * noise)

    def _squared(self, state: Reads) -> Scalar:
        away = state.position - self.target.position
        return away @ away + jnp.asarray(self.tag_height - self.target.position_z) ** 2
