r"""Standard normal draws by counter, many times cheaper than ``jax.random.normal``.

``jax.random.normal`` turns 64 bits into one number by the inverse error function, and its
generator is a loop of several dozen kernels. Here the same generator (Threefry-2x32 with 20
rounds) is written out, and its two words make two numbers of single precision that leave as one
word of 64 bits: so one loop makes all, element by element, and XLA vectorises it.

Source: J. Salmon, M. Moraes, R. Dror, D. Shaw, "Parallel random numbers: as easy as 1, 2, 3",
SC11, 2011, section 3.3 (Threefry); G. Box, M. Muller, "A note on the generation of random
normal deviates", Ann. Math. Statist. 29(2), 1958.
"""

import functools as ft
import math
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray, UInt32

from kedge.numerics.apart import apart

ROTATIONS = (13, 15, 26, 6), (17, 29, 16, 24)
PARITY = 0x1BD11BDA
TAG = 0x6B656467
"""The counters' upper word: keys are split and folded with others, so no number comes twice."""
ROOT_HALF = 0x3F3504F3
"""Bits of the root of one half in single precision."""

Words = UInt32[Array, " n"]


def normals(
    key: PRNGKeyArray, shape: tuple[int, ...], dtype: Any = float
) -> Float[Array, "..."]:
    r"""Standard normal numbers; the same for a key in a batch, alone, or in another order.

    Two words of 32 bits make u, v in (0, 1], and these
    $\sqrt{-2 \ln u}\,(\cos 2\pi v, \sin 2\pi v)$ in single precision, whatever the ``dtype``.
    What that costs beside 53 random bits a number: every number has 24 digits, none is beyond
    6.8, and pairs within 0.002 of the origin lie on a few hundred circles.
    """
    size = math.prod(shape)
    if not _is_threefry(key):
        return jr.normal(key, shape, dtype)
    words = jr.key_data(key)
    # Zero, but no compiler of the loop knows that.
    pairs = _pairs(words, (words[0] >> 31) & 2, -(-size // 2))
    each = lax.bitcast_convert_type(pairs, jnp.float32)
    return each.reshape(-1)[:size].reshape(shape).astype(dtype)


def fold_in(key: PRNGKeyArray, number: Int[Array, ""] | int) -> PRNGKeyArray:
    """The key that ``jax.random.fold_in`` makes, without its loop."""
    if not _is_threefry(key):
        return jr.fold_in(key, number)
    lower = jnp.asarray(number).astype(jnp.uint32)[None]
    words = threefry(jr.key_data(key), jnp.zeros_like(lower), lower)
    return jr.wrap_key_data(jnp.concatenate(words), impl="threefry2x32")


def split(key: PRNGKeyArray, count: int = 2) -> Key[Array, " n"]:
    """The keys that ``jax.random.split`` makes, without its loop."""
    if not _is_threefry(key):
        return jr.split(key, count)
    lower = lax.iota(jnp.uint32, count)
    words = threefry(jr.key_data(key), jnp.zeros_like(lower), lower)
    return jr.wrap_key_data(jnp.stack(words, axis=1), impl="threefry2x32")


def threefry(key: UInt32[Array, "2"], upper: Words, lower: Words) -> tuple[Words, Words]:
    """Threefry-2x32 with 20 rounds, as ``jax.random`` has it, but written out."""
    schedule = key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(PARITY)
    one, two = upper + schedule[0], lower + schedule[1]
    for turn in range(5):
        for rotation in ROTATIONS[turn % 2]:
            one = one + two
            two = (two << rotation) | (two >> (32 - rotation))
            two = one ^ two
        one = one + schedule[(turn + 1) % 3]
        two = two + schedule[(turn + 2) % 3] + jnp.uint32(turn + 1)
    return one, two


def _is_threefry(key: PRNGKeyArray) -> bool:
    return jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and jr.key_impl(key) == "threefry2x32"


@ft.partial(apart, static=2)
def _pairs(key: UInt32[Array, "2"], zero: UInt32[Array, ""], half: int) -> Array:
    """Two numbers in each word of 64 bits; without such words, in each row.

    Whether a product and the sum after it are rounded once or twice is up to the compiler and
    to the machine. Here every product passes through integers (an exclusive or with ``zero``),
    so it is rounded by itself, and a draw has the same bits in every program.
    """
    counters = lax.iota(jnp.uint32, half)
    first, second = threefry(key, jnp.full(half, TAG, jnp.uint32), counters)
    radius = jnp.sqrt(-2 * _log_unit(first, zero))
    one, other = (radius * part for part in _turned(second, zero))
    if not jax.config.read("jax_enable_x64"):
        return jnp.stack([one, other], axis=1)
    bits = (lax.bitcast_convert_type(x, jnp.uint32).astype(jnp.uint64) for x in (one, other))
    low, high = bits
    return (high << 32) | low


def _log_unit(word: Words, zero: UInt32[Array, ""]) -> Float[Array, " n"]:
    r"""$\ln u$, $u = (w + \tfrac12) / 2^{32}$, of w without its last bit; to 1e-7 or 6 digits.

    As arithmetic, since a call of the library's logarithm is not vectorised.

    Source: S. Moshier, "Methods and Programs for Mathematical Functions", 1989 (the polynomial,
    of the Cephes library's ``logf``).
    """
    # Signed, since machines convert those faster.
    number = (word >> 1).astype(jnp.int32).astype(jnp.float32) + 0.25
    parts = lax.bitcast_convert_type(number, jnp.int32) - ROOT_HALF
    fraction = (parts & 0x7FFFFF) + ROOT_HALF
    m = lax.bitcast_convert_type(fraction, jnp.float32) - 1  # between the roots of 1/2 and 2
    square = m * m
    bend = _rounded(m * square * _horner(LOGARITHM, m, zero), zero)
    whole = ((parts >> 23) - 31).astype(jnp.float32) * np.float32(math.log(2))
    return m + (bend - square / 2) + _rounded(whole, zero)


LOGARITHM = [
    *(3.3333331174e-1, -2.4999993993e-1, 2.0000714765e-1, -1.6668057665e-1, 1.4249322787e-1),
    *(-1.2420140846e-1, 1.1676998740e-1, -1.1514610310e-1, 7.0376836292e-2),
]


def _turned(
    word: Words, zero: UInt32[Array, ""]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    r"""Cosine and sine of the angle $2 \pi w / 2^{32}$, less an eighth of a turn; to 1e-6."""
    quarter = word >> 30
    angle_bits = (word & jnp.uint32(2**30 - 1)).astype(jnp.int32).astype(jnp.float32)
    x = (angle_bits - 2.0**29) * np.float32(math.pi / 2**31)
    x2 = x * x
    sine = x * _horner([(-1) ** k / math.factorial(2 * k + 1) for k in range(5)], x2, zero)
    cosine = _horner([(-1) ** k / math.factorial(2 * k) for k in range(5)], x2, zero)
    odd = (quarter & 1) == 1
    first, second = lax.select(odd, sine, cosine), lax.select(odd, cosine, sine)
    # Quarters 1 and 2 are those to the left, 2 and 3 those below.
    return _signed(first, (quarter + 1) & 2), _signed(second, quarter & 2)


def _signed(value: Float[Array, " n"], two: Words) -> Float[Array, " n"]:
    """With the sign turned where ``two`` is 2, not 0."""
    return lax.bitcast_convert_type(
        lax.bitcast_convert_type(value, jnp.uint32) ^ (two << 30), jnp.float32
    )


def _horner(
    coefficients: list[float], x: Float[Array, " n"], zero: UInt32[Array, ""]
) -> Float[Array, " n"]:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = _rounded(value * x, zero) + coefficient
    return value


def _rounded(product: Float[Array, " n"], zero: UInt32[Array, ""]) -> Float[Array, " n"]:
    """A product that no compiler can join with what is added to it."""
    bits = lax.bitcast_convert_type(product, jnp.uint32)
    return lax.bitcast_convert_type(bits ^ zero, jnp.float32)
