"""Inertial measurement units as their makers specify them.

Presets are written in the units of data sheets and converted once, here.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.errors import UnknownName
from kedge.core.quantities import Scalar
from kedge.core.registry import unknown

DEGREE = 0.017453292519943295  # rad
HOUR = 3600.0  # s
STANDARD_GRAVITY = 9.80665  # m/s^2
MICRO_G = 1e-6 * STANDARD_GRAVITY  # m/s^2
MILLI_G = 1e-3 * STANDARD_GRAVITY  # m/s^2
MILLIGAL = 1e-5  # m/s^2
DEGREES_PER_HOUR = DEGREE / HOUR  # rad/s
DEGREES_PER_ROOT_HOUR = DEGREE / HOUR**0.5  # rad/s per sqrt(Hz)
METRES_PER_SECOND_PER_ROOT_HOUR = 1 / HOUR**0.5  # m/s^2 per sqrt(Hz)


class ImuModel(NamedTuple):
    """Errors of an IMU, for each of its axes alike, in SI units."""

    gyroscope_noise: Scalar  # rad/s per sqrt(Hz), N
    accelerometer_noise: Scalar  # m/s^2 per sqrt(Hz), N
    gyroscope_instability: Scalar  # rad/s, B
    accelerometer_instability: Scalar  # m/s^2, B
    gyroscope_walk: Scalar  # rad/s^2 per sqrt(Hz), K
    accelerometer_walk: Scalar  # m/s^3 per sqrt(Hz), K
    gyroscope_turn_on: Scalar  # rad/s, standard deviation
    accelerometer_turn_on: Scalar  # m/s^2, standard deviation


PRESETS: dict[str, ImuModel] = {
    # InvenSense PS-MPU-6000A rev. 3.4, section 6: 0.005 deg/s/sqrt(Hz), 400 ug/sqrt(Hz), read
    # there. It states neither instability nor walk, so those are of the usual size in its
    # class; turn-on is what a coarse calibration leaves of 20 deg/s and 80 mg.
    "mpu6050": ImuModel(
        gyroscope_noise=0.005 * DEGREE,
        accelerometer_noise=400 * MICRO_G,
        gyroscope_instability=10 * DEGREES_PER_HOUR,
        accelerometer_instability=0.1 * MILLI_G,
        gyroscope_walk=2e-5,
        accelerometer_walk=2e-4,
        gyroscope_turn_on=0.1 * DEGREE,
        accelerometer_turn_on=0.03,
    ),
    # Analog Devices ADIS16405 rev. B, table 1. Checked against what others quote of it are the
    # gyroscopes' instability and turn-on; the walks are not from it.
    "adis16405": ImuModel(
        gyroscope_noise=2.0 * DEGREES_PER_ROOT_HOUR,
        accelerometer_noise=0.2 * METRES_PER_SECOND_PER_ROOT_HOUR,
        gyroscope_instability=0.007 * DEGREE,
        accelerometer_instability=0.2 * MILLI_G,
        gyroscope_walk=1.22173e-5,
        accelerometer_walk=1.96133e-4,
        gyroscope_turn_on=3.0 * DEGREE,
        accelerometer_turn_on=50 * MILLI_G,
    ),
    # Analog Devices ADIS16465-2 rev. C, table 1; the walks are usual of its class. Checked
    # against its first page are the angular random walk and the accelerometers' instability.
    "adis16465": ImuModel(
        gyroscope_noise=0.15 * DEGREES_PER_ROOT_HOUR,
        accelerometer_noise=0.012 * METRES_PER_SECOND_PER_ROOT_HOUR,
        gyroscope_instability=2.5 * DEGREES_PER_HOUR,
        accelerometer_instability=3.6 * MICRO_G,
        gyroscope_walk=1e-7,
        accelerometer_walk=1e-6,
        gyroscope_turn_on=0.14 * DEGREE,
        accelerometer_turn_on=0.6 * MILLI_G,
    ),
}


def preset(name: str) -> ImuModel:
    """The model of an IMU by its name.

    Raises:
        UnknownName: there is none of that name.
    """
    if name not in PRESETS:
        raise UnknownName(unknown("IMU", name, sorted(PRESETS)))
    return PRESETS[name]


class Errors(NamedTuple):
    """What is added to true readings; leading axis K."""

    specific_force: Float[Array, "K 3"]
    angular_rate: Float[Array, "K 3"]
    accelerometer_bias: Float[Array, "K 3"]
    """The part of it that wanders slowly, at the end of each step."""
    gyroscope_bias: Float[Array, "K 3"]


def errors(
    model: ImuModel, steps: int, dt: Scalar, key: PRNGKeyArray, instability: bool = True
) -> Errors:
    r"""Errors of one run: turn-on bias, random walk, flicker and white noise.

    White: std $N / \sqrt{\Delta t}$. Walk: $K \sqrt{\Delta t}$ a step. Flicker of the level
    B is a sum of first-order processes with times 4 apart; there is none without
    ``instability``.

    Source: IEEE Std 952, "IEEE standard specification format guide and test procedure for
    single-axis interferometric fiber optic gyros", 1997, annex C.
    """
    keys = jr.split(key, 4)

    def one(noise: Scalar, level: Scalar, walk: Scalar, first: Scalar, key: PRNGKeyArray):
        white_key, walk_key, first_key, flicker_key = jr.split(key, 4)
        white = noise / jnp.sqrt(dt) * jr.normal(white_key, (steps, 3))
        wander = walk * jnp.sqrt(dt) * jr.normal(walk_key, (steps, 3))
        bias = first * jr.normal(first_key, (3,))[None] + jnp.cumsum(wander, axis=0)
        if instability:
            white = white + level * _flicker(steps, dt, flicker_key)
        return white, bias

    force, accelerometer = one(
        model.accelerometer_noise,
        model.accelerometer_instability,
        model.accelerometer_walk,
        model.accelerometer_turn_on,
        keys[0],
    )
    rate, gyroscope = one(
        model.gyroscope_noise,
        model.gyroscope_instability,
        model.gyroscope_walk,
        model.gyroscope_turn_on,
        keys[1],
    )
    return Errors(force + accelerometer, rate + gyroscope, accelerometer, gyroscope)


FLICKER_TIMES = 4.0 ** np.arange(-1, 7)  # s; 0.25 to 4096
FLICKER_STD = (math.log(4.0) / math.pi) ** 0.5
"""Of each process for B = 1: their spectra add up to B^2 / (2 pi f)."""


def _flicker(steps: int, dt: Scalar, key: PRNGKeyArray) -> Float[Array, "K 3"]:
    kept = jnp.exp(-dt / FLICKER_TIMES)
    fresh = jnp.sqrt(1 - kept**2)
    shocks = jr.normal(key, (steps, 3, len(FLICKER_TIMES)))
    first = shocks[0]

    def body(state: Array, shock: Array) -> tuple[Array, Array]:
        state = kept[None] * state + fresh[None] * shock
        return state, jnp.sum(state, axis=-1)

    return FLICKER_STD * lax.scan(body, first, shocks)[1]
