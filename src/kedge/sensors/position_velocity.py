"""Position and velocity in one reading: a GNSS receiver, or GNSS and odometry together."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Position, Speed, Velocity
from kedge.core.registry import sensors


class Measurement(NamedTuple):
    position: Position
    velocity: Velocity


@sensors.add("position-velocity")
class PositionVelocity(AbstractSensor[Measurement]):
    r"""Position and velocity in the plane, in the map frame.

    $z = [p, \dot p] + v$, with independent errors, isotropic in each of the two.

    Wheel odometry measures in the body frame; it fits here only after a turn by the heading.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 14.3.1 (loose coupling).
    """

    reads = Measurement
    measures = Measurement
    nominal_rate = 10.0
    position_std: Metres = 0.5
    velocity_std: Speed = 0.05

    def observe(self, state: Measurement) -> Measurement:
        return state

    def noise_std(self, state: Measurement) -> Measurement:
        return Measurement(jnp.full(2, self.position_std), jnp.full(2, self.velocity_std))
