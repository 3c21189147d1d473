"""GNSS receiver reporting planar position."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Position
from kedge.core.registry import sensors


class Measurement(NamedTuple):
    position: Position


class Reads(NamedTuple):
    position: Position


@sensors.add("gnss")
class Gnss(AbstractSensor[Measurement]):
    r"""Position fixes in the plane.

    $z = p + v$ in the map frame, with independent, isotropic errors.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 14.3.1 (loose coupling).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 1.0
    std: Metres = 1.0

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.position)

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(2, self.std))
