"""GNSS receiver reporting position in three dimensions."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Position3
from kedge.core.registry import sensors

ZEROS: Any = np.zeros(3)


class Measurement(NamedTuple):
    position: Position3


class Reads(NamedTuple):
    position: Position3
    gnss_bias: Position3 = ZEROS


@sensors.add("gnss3")
class Gnss3(AbstractSensor[Measurement]):
    r"""Position fixes in space.

    $z = p + b + v$ in the map frame; height is worse than the plane. What lasts of a receiver's
    errors is the bias b (``gnss_bias``), as in ``gnss``.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 14.3.1 (loose coupling).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    horizontal_std: Metres = 0.5
    vertical_std: Metres = 1.0

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.position + jnp.asarray(state.gnss_bias))

    def noise_std(self, state: Reads) -> Measurement:
        horizontal, vertical = jnp.asarray(self.horizontal_std), jnp.asarray(self.vertical_std)
        return Measurement(jnp.stack([horizontal, horizontal, vertical]))
