"""GNSS receiver reporting planar position."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Position
from kedge.core.registry import sensors

ZEROS: Any = np.zeros(2)


class Measurement(NamedTuple):
    position: Position


class Reads(NamedTuple):
    position: Position
    gnss_bias: Position = ZEROS


@sensors.add("gnss")
class Gnss(AbstractSensor[Measurement]):
    r"""Position fixes in the plane.

    $z = p + b + v$ in the map frame, with independent, isotropic errors v.

    The errors of a receiver last for a minute and are no noise: estimate them as the bias b
    (``gnss_bias``) with ``time_constant = 60`` and a ``random_walk`` of $b \sqrt{2 / 60}$.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 14.3.1 (loose coupling).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 1.0
    std: Metres = 1.0

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.position + jnp.asarray(state.gnss_bias))

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(2, self.std))
