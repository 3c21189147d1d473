"""A vehicle that is known to stand: no velocity, no angular rate, and gyroscopes read bias."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import AngularRate3, Speed, Velocity3, YawRate
from kedge.core.registry import sensors


class Still(NamedTuple):
    velocity: Velocity3


class Biased(NamedTuple):
    gyroscope_bias: AngularRate3


class AtRest(NamedTuple):
    angular_rate: AngularRate3


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


@sensors.add("zero-rate")
class ZeroRate(AbstractSensor[AtRest]):
    r"""$z = b_\omega + w$: what gyroscopes read while the vehicle stands is their bias.

    For states with ``gyroscope_bias`` but no angular rate, such as an augmented
    ``strapdown``. A mean over $\Delta t$ of gyroscopes with the density N
    has the deviation $N / \sqrt{\Delta t}$.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 15.3 (zero updates).
    """

    reads = Biased
    measures = AtRest
    nominal_rate = 10.0
    std: YawRate = 3e-4

    def observe(self, state: Biased) -> AtRest:
        return AtRest(state.gyroscope_bias)

    def noise_std(self, state: Biased) -> AtRest:
        return AtRest(jnp.full(3, self.std))
