"""Doppler velocity logs: velocity over the ground, or through the water."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import (
    AngularRate3,
    Attitude,
    Position3,
    Radians3,
    Ratio,
    Speed,
    Velocity3,
)
from kedge.core.registry import sensors
from kedge.core.rotations import conjugate, exp, rotate

ZEROS: Any = np.zeros(3)


class Measurement(NamedTuple):
    velocity_body: Velocity3


class Reads(NamedTuple):
    velocity_body: Velocity3
    angular_rate: AngularRate3
    doppler_scale: Ratio = 1.0
    doppler_misalignment: Radians3 = ZEROS
    doppler_arm: Position3 = ZEROS


class ReadsThroughWater(NamedTuple):
    attitude: Attitude
    velocity_body: Velocity3
    angular_rate: AngularRate3
    current: Velocity3 = ZEROS
    doppler_scale: Ratio = 1.0
    doppler_misalignment: Radians3 = ZEROS
    doppler_arm: Position3 = ZEROS


def _as_turned(state: Reads | ReadsThroughWater, velocity: Float[Array, "3"]) -> Measurement:
    """What the instrument makes of a velocity of the body's origin."""
    swing = jnp.cross(state.angular_rate, state.doppler_arm)
    turned = rotate(exp(-jnp.asarray(state.doppler_misalignment)), velocity + swing)
    return Measurement(state.doppler_scale * turned)


@sensors.add("doppler")
class Doppler(AbstractSensor[Measurement]):
    r"""A Doppler velocity log that tracks the bottom: forward, left, up.

    $z = s\, \exp(-\epsilon)\, (v_b + \omega \times l) + v$

    with the scale s, the misalignment $\epsilon$ (a small turn, rad) and the arm l (m) from the
    state where they are estimated (``doppler_scale``, ``doppler_misalignment``,
    ``doppler_arm``). What is known of arm and orientation beforehand is the sensor's mount;
    the estimated ones come on top, in the sensor's axes. Without bottom lock there is no
    reading, or one that is missing.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 6.5 (Doppler sonar) and 2.5.5 (lever arms).
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 5.0
    std: Speed = 0.02

    def observe(self, state: Reads) -> Measurement:
        return _as_turned(state, state.velocity_body)

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(3, self.std))


@sensors.add("doppler-water")
class DopplerThroughWater(AbstractSensor[Measurement]):
    r"""A Doppler velocity log that tracks the water below: forward, left, up.

    $z = s\, \exp(-\epsilon)\, (v_b - R^\top c + \omega \times l) + v$

    with the current c (east, north, up; m/s) from the state where it is estimated
    (``current``), and all else as for ``doppler``, with which it shares scale, misalignment and
    arm: one instrument does both.

    Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
    Systems", 2nd ed., 2013, section 6.5 (Doppler sonar).
    """

    reads = ReadsThroughWater
    measures = Measurement
    nominal_rate = 5.0
    std: Speed = 0.03

    def observe(self, state: ReadsThroughWater) -> Measurement:
        drift = rotate(conjugate(state.attitude), jnp.asarray(state.current))
        return _as_turned(state, state.velocity_body - drift)

    def noise_std(self, state: ReadsThroughWater) -> Measurement:
        return Measurement(jnp.full(3, self.std))
