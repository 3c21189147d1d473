"""Attitude and heading reference system: the whole attitude in one reading."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Attitude, Radians, Radians3
from kedge.core.registry import sensors
from kedge.core.rotations import conjugate, exp, multiply, rotate

ZEROS: Any = np.zeros(3)


class Measurement(NamedTuple):
    attitude: Attitude


class Reads(NamedTuple):
    attitude: Attitude
    attitude_bias: Radians3 = ZEROS


@sensors.add("attitude")
class AttitudeReference(AbstractSensor[Measurement]):
    r"""Roll, pitch and heading as one rotation; gravity tells tilt better than north is told.

    $z = q \otimes \exp(b) \otimes \exp(v)$ with the covariance
    $\sigma_t^2 (I - n n^\top) + \sigma_\psi^2\, n n^\top$, where n is the vertical in the body:
    errors of the heading are turns about the vertical, however the body lies.

    The bias b (``attitude_bias``, rad) is a small turn in the body: a mount that is not quite
    known.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 6.1 (attitude measurement).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    tilt_std: Radians = 0.009
    heading_std: Radians = 0.035

    def observe(self, state: Reads) -> Measurement:
        return Measurement(multiply(state.attitude, exp(jnp.asarray(state.attitude_bias))))

    def noise_cov(self, state: Any) -> Float[Array, "3 3"]:
        """Of a turn about the vertical, and of one about the axes that lie level."""
        vertical = rotate(conjugate(state.attitude), jnp.array([0.0, 0.0, 1.0]))
        tilt, heading = self.tilt_std**2, self.heading_std**2
        return tilt * jnp.eye(3) + (heading - tilt) * jnp.outer(vertical, vertical)

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.sqrt(jnp.diag(self.noise_cov(state))))
