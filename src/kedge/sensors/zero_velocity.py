"""A vehicle that is known to stand: its velocity and its angular rate are nothing."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import AngularRate3, Speed, Velocity3, YawRate
from kedge.core.registry import sensors


class Still(NamedTuple):
    velocity: Velocity3


class StillAndSteady(NamedTuple):
    velocity: Velocity3
    angular_rate: AngularRate3


@sensors.add("zero-velocity")
class ZeroVelocity(AbstractSensor[Still]):
    r"""$z = v + w$, read as zero while the vehicle stands.

    Who says that it stands is no business of the sensor: see ``standing`` in a rig file.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 15.3 (zero updates).
    """

    reads = Still
    measures = Still
    nominal_rate = 10.0
    std: Speed = 0.005

    def observe(self, state: Still) -> Still:
        return Still(state.velocity)

    def noise_std(self, state: Still) -> Still:
        return Still(jnp.full(3, self.std))


@sensors.add("zero-motion")
class ZeroMotion(AbstractSensor[StillAndSteady]):
    r"""$z = [v, \omega] + w$, read as zero while the vehicle stands.

    It tells the bias of the gyroscopes, of states that know their angular rate; the earth's
    own is below the bias of small gyroscopes.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 15.3 (zero updates).
    """

    reads = StillAndSteady
    measures = StillAndSteady
    nominal_rate = 10.0
    std: Speed = 0.005
    rate_std: YawRate = 0.001

    def observe(self, state: StillAndSteady) -> StillAndSteady:
        return StillAndSteady(state.velocity, state.angular_rate)

    def noise_std(self, state: StillAndSteady) -> StillAndSteady:
        return StillAndSteady(jnp.full(3, self.std), jnp.full(3, self.rate_std))
