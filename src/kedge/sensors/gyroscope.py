"""Gyroscopes: how fast the body turns about its own axes."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import AngularRate3, YawRate
from kedge.core.registry import sensors

ZEROS: Any = np.zeros(3)


class Measurement(NamedTuple):
    angular_rate: AngularRate3


class Reads(NamedTuple):
    angular_rate: AngularRate3
    gyroscope_bias: AngularRate3 = ZEROS


@sensors.add("gyroscope")
class Gyroscope(AbstractSensor[Measurement]):
    r"""Angular rates about forward, left and up.

    $z = \omega + b + v$

    with the bias b from the state where it is estimated (``gyroscope_bias``).

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 4.4 (error characteristics).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    std: YawRate = 0.005

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.angular_rate + jnp.asarray(state.gyroscope_bias))

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(3, self.std))
