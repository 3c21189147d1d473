"""What a camera on a marked lane tells: how far off, how turned, and the wheels: how fast."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Metres, Radians, Speed
from kedge.core.registry import sensors


class Measurement(NamedTuple):
    offset: Metres
    heading_error: Radians
    speed_error: Speed


@sensors.add("tracking-error")
class TrackingError(AbstractSensor[Measurement]):
    r"""Offset from the path, heading against it, and speed beyond the nominal.

    $z = [e_y, e_\varphi, e_v] + v$, with independent errors.

    Source: R. Rajamani, "Vehicle Dynamics and Control", 2nd ed., 2012, section 2.5.
    """

    reads = Measurement
    measures = Measurement
    nominal_rate = 50.0
    offset_std: Metres = 0.05
    heading_std: Radians = 0.005
    speed_std: Speed = 0.1

    def observe(self, state: Measurement) -> Measurement:
        return state

    def noise_std(self, state: Measurement) -> Measurement:
        return Measurement(
            *map(jnp.asarray, (self.offset_std, self.heading_std, self.speed_std))
        )
