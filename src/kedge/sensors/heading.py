"""The heading of a vehicle in the plane, however it was found."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Heading, Radians
from kedge.core.registry import sensors
from kedge.core.rotations import wrap


class Measurement(NamedTuple):
    heading: Heading


class Reads(NamedTuple):
    heading: Heading
    heading_bias: Heading = 0.0


@sensors.add("heading")
class PlanarHeading(AbstractSensor[Measurement]):
    r"""The heading, from east to the left: of an IMU, a compass, two antennas.

    $z = \psi + b + v$, wrapped.

    The bias b (``heading_bias``) is where the instrument takes zero to be. An IMU without a
    compass calls its heading at switch-on zero and drifts from there: estimate b as a state.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 6.1 (attitude measurement).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    std: Radians = 0.035

    def observe(self, state: Reads) -> Measurement:
        return Measurement(wrap(state.heading + state.heading_bias))

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.asarray(self.std))
