"""Speed of a wheel, along the nose."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Attitude, Ratio, Speed, Velocity3
from kedge.core.registry import sensors
from kedge.core.rotations import conjugate, rotate


class Measurement(NamedTuple):
    speed: Speed


class Reads(NamedTuple):
    velocity: Velocity3
    attitude: Attitude
    odometer_scale: Ratio = 1.0


@sensors.add("odometer")
class Odometer(AbstractSensor[Measurement]):
    r"""What a wheel or an encoder makes of the speed along the nose.

    $z = s\,e_x^\top R^\top v + w$ at the wheel: its place and its direction are the sensor's
    mount. The scale s (``odometer_scale``) follows the tyre and its load; estimate it as a slow
    state. The noise grows with the speed.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 16.3.1 (odometers).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    std: Speed = 0.02
    std_per_speed: Ratio = 0.0

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.odometer_scale * _ahead(state))

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(self.std + self.std_per_speed * jnp.abs(_ahead(state)))


def _ahead(state: Reads) -> Speed:
    return rotate(conjugate(state.attitude), state.velocity)[0]
