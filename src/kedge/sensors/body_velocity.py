"""Body velocities and yaw rate, as much of the literature on underwater vehicles assumes."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import AngularRate3, Speed, Velocity3, YawRate
from kedge.core.registry import sensors


class Measurement(NamedTuple):
    velocity_body: Velocity3
    yaw_rate: YawRate


class Reads(NamedTuple):
    velocity_body: Velocity3
    angular_rate: AngularRate3


@sensors.add("body-velocity")
class BodyVelocity(AbstractSensor[Measurement]):
    r"""Surge, sway, heave and yaw rate, forward-left-up.

    $z = [v_b, \omega_z] + v$

    It knows neither depth nor tilt: what those need is a pressure sensor and an attitude.

    Source: Ngatini et al., "Comparison of AUV position estimation using Kalman filter, ensemble
    Kalman filter and fuzzy Kalman filter algorithm in the specified trajectories", 2022, the
    measurement matrix.
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    velocity_std: Speed = 0.02
    yaw_rate_std: YawRate = 0.005

    def observe(self, state: Reads) -> Measurement:
        return Measurement(state.velocity_body, state.angular_rate[2])

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(3, self.velocity_std), jnp.asarray(self.yaw_rate_std))
