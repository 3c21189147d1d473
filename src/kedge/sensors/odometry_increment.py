"""How far a vehicle in the plane has come since the reading before: laser odometry."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import (
    Heading,
    Metres,
    Position,
    Radians,
    Seconds,
    Velocity,
    YawRate,
)
from kedge.core.registry import sensors
from kedge.core.rotations import direction, wrap


class Measurement(NamedTuple):
    offset: Position
    """How far forward and to the left, in the axes of the pose before."""
    turn: Heading


class Reads(NamedTuple):
    heading: Heading
    velocity: Velocity
    yaw_rate: YawRate


@sensors.add("odometry-increment")
class OdometryIncrement(AbstractSensor[Measurement]):
    r"""The pose relative to that of ``interval`` seconds before.

    $z = [\mathrm{Rot}(\omega T - \psi)\, v\, T,\ \omega T] + w$: what a vehicle that kept its
    velocity and its yaw rate has done in the last T seconds. It is for vehicles whose state has
    both, such as ``coasting-body``; their acceleration within T is neglected, so T is short. A
    vehicle without them is driven by increments instead: ``planar-twist`` with the control's
    ``sampling = "increments"``.

    Source: S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics", 2005, section 5.4 (motion as
    the difference of two poses of the odometry).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    interval: Seconds = 0.1
    offset_std: Metres = 0.01
    turn_std: Radians = 0.005

    def observe(self, state: Reads) -> Measurement:
        turn = state.yaw_rate * self.interval
        way = state.velocity * self.interval
        before = state.heading - turn
        ahead, aside = direction(before), direction(before + jnp.pi / 2)
        return Measurement(jnp.stack([ahead @ way, aside @ way]), wrap(turn))

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(2, self.offset_std), jnp.asarray(self.turn_std))
