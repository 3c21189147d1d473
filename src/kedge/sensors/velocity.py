"""Velocity in the map frame: GNSS Doppler, or odometry turned by a known heading."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Speed, Velocity
from kedge.core.registry import sensors


class Measurement(NamedTuple):
    velocity: Velocity


class Reads(NamedTuple):
    velocity: Velocity


@sensors.add("velocity")
class MapVelocity(AbstractSensor[Measurement]):
    r"""Velocity in the plane, in the map frame.

    $z = \dot p + v$, with independent, isotropic errors.

    Wheel odometry measures in the body frame; it fits here only after a turn by the heading.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 14.3.1 (loose coupling).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    std: Speed = 0.05

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.velocity)

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(2, self.std))
