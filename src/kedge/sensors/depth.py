"""Depth from the pressure of the water."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Position3, Range
from kedge.core.registry import sensors


class Measurement(NamedTuple):
    depth: Range


class Reads(NamedTuple):
    position: Position3
    depth_bias: Metres = 0.0


@sensors.add("depth")
class Depth(AbstractSensor[Measurement]):
    r"""Depth below the map's height 0, positive downwards.

    $z = -p_z + b + v$

    The bias b (``depth_bias``) is what tide, waves and the pressure of the air add.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 6.2 (height and depth measurement).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    std: Metres = 0.05

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.depth_bias - state.position[2])

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.asarray(self.std))
