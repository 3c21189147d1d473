"""Wheels that neither slide sideways nor leave the ground: a reading of nothing."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Attitude, Speed, Velocity3
from kedge.core.registry import sensors
from kedge.core.rotations import conjugate, rotate


class Measurement(NamedTuple):
    lateral: Speed
    vertical: Speed


class Reads(NamedTuple):
    velocity: Velocity3
    attitude: Attitude


@sensors.add("rolling")
class Rolling(AbstractSensor[Measurement]):
    r"""The non-holonomic constraint of a vehicle on wheels.

    $z = [e_y^\top R^\top v,\ e_z^\top R^\top v] + w$, read as zero. It holds at the axle that
    is not steered: the sensor's mount says where that is and how the vehicle's nose is turned.

    Source: G. Dissanayake et al., "The aiding of a low-cost strapdown inertial measurement unit
    using vehicle model constraints for land vehicle applications", IEEE Trans. Robotics and
    Automation 17(5), 2001.
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    lateral_std: Speed = 0.02
    vertical_std: Speed = 0.02

    def observe(self, state: Reads) -> Measurement:
        inside = rotate(conjugate(state.attitude), state.velocity)
        return Measurement(inside[1], inside[2])

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.asarray(self.lateral_std), jnp.asarray(self.vertical_std))
