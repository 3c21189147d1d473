"""Velocity over ground in space, as a GNSS receiver derives it from Doppler shifts."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Speed, Velocity3
from kedge.core.registry import sensors


class Measurement(NamedTuple):
    velocity: Velocity3


class Reads(NamedTuple):
    velocity: Velocity3


@sensors.add("velocity3")
class MapVelocity3(AbstractSensor[Measurement]):
    r"""Velocity of the antenna in the map frame.

    $z = v + R (\omega \times l) + w$ with the lever arm of the sensor's mount, which needs a
    state that knows its angular rate.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 14.3.1 (loose coupling).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    horizontal_std: Speed = 0.05
    vertical_std: Speed = 0.05

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.velocity)

    def noise_std(self, state: Reads) -> Measurement:
        horizontal, vertical = jnp.asarray(self.horizontal_std), jnp.asarray(self.vertical_std)
        return Measurement(jnp.stack([horizontal, horizontal, vertical]))
