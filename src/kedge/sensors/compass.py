"""A compass on a vehicle that rolls and pitches."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Attitude, Heading, Radians
from kedge.core.registry import sensors
from kedge.core.rotations import polar, rotate, wrap


class Measurement(NamedTuple):
    heading: Heading


class Reads(NamedTuple):
    attitude: Attitude
    compass_bias: Radians = 0.0


@sensors.add("compass")
class Compass(AbstractSensor[Measurement]):
    r"""The heading of the nose, from east to the left.

    $z = \operatorname{atan2}(f_y, f_x) + b + v$ where f is the nose in the map, $R e_x$.

    The bias b (``compass_bias``) is declination and deviation that the log has not corrected.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 6.1 (attitude measurement).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    std: Radians = 0.035

    def observe(self, state: Reads) -> Measurement:
        _, heading = polar(rotate(state.attitude, jnp.array([1.0, 0.0, 0.0]))[:2])
        return Measurement(wrap(heading + state.compass_bias))

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.asarray(self.std))
