r"""Standard normal draws by counter, several times cheaper than ``jax.random.normal``.

``jax.random.normal`` turns 64 bits into one number by the inverse error function, and its
generator is a loop that XLA cannot fuse with what turns its words into numbers. Here the same
generator (Threefry-2x32 with 20 rounds) is written out, its two words make two numbers, and all
of it is arithmetic element by element, which XLA fuses and vectorises.

Source: J. Salmon, M. Moraes, R. Dror, D. Shaw, "Parallel random numbers: as easy as 1, 2, 3",
SC11, 2011, section 3.3 (Threefry); G. Box, M. Muller, "A note on the generation of random
normal deviates", Ann. Math. Statist. 29(2), 1958.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray, UInt32

ROTATIONS = (13, 15, 26, 6), (17, 29, 16, 24)
PARITY = 0x1BD11BDA
TAG = 0x6B656467
"""The counters' upper word: keys are split and folded with others, so no number comes twice."""

Words = UInt32[Array, " n"]


def normals(
    key: PRNGKeyArray, shape: tuple[int, ...], dtype: Any = float
) -> Float[Array, "..."]:
    r"""Standard normal numbers; the same for a key in a batch, alone, or in another order.

    Two words of 32 bits make u, v in (0, 1), and these
    $\sqrt{-2 \ln u}\,(\cos 2\pi v, \sin 2\pi v)$. What that costs beside 53 random bits a
    number: numbers lie on $2^{32}$ circles at $2^{32}$ angles, and none beyond 6.8.
    """
    size = math.prod(shape)
    half = -(-size // 2)
    if not jnp.issubdtype(key.dtype, jax.dtypes.prng_key) or jr.key_impl(key) != "threefry2x32":
        return jr.normal(key, shape, dtype)
    counters = lax.iota(jnp.uint32, half)
    first, second = threefry(jr.key_data(key), jnp.full(half, TAG, jnp.uint32), counters)
    kind = jnp.zeros((), dtype).dtype
    radius = jnp.sqrt(-2 * _log_unit(first, kind))
    cosine, sine = _turned(second, kind)
    # Kept as numbers: fused with its use, each half would draw both words and the radius anew.
    pair = lax.optimization_barrier((radius * cosine, radius * sine))
    return jnp.concatenate(pair)[:size].reshape(shape)


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


def _log_unit(word: Words, kind: np.dtype) -> Float[Array, " n"]:
    r"""$\ln u$, $u = (w + \tfrac12) / 2^{32}$, by $\ln m = 2\,\mathrm{artanh}\frac{m-1}{m+1}$.

    As arithmetic, since a call of the library's logarithm is not vectorised. To 1e-13.
    """
    bits, bias, integer = (52, 1023, jnp.int64) if kind == jnp.float64 else (23, 127, jnp.int32)
    parts = lax.bitcast_convert_type(word.astype(kind) + 0.5, integer)
    fraction = (parts & ((1 << bits) - 1)) | (bias << bits)
    m = lax.bitcast_convert_type(fraction, kind)  # 1 <= m < 2
    high = m > math.sqrt(2)
    m = jnp.where(high, m / 2, m)
    exponent = (parts >> bits).astype(jnp.int32) - (bias + 32) + high
    t = (m - 1) / (m + 1)
    series = _horner([2 / (2 * k + 1) for k in range(8)], t * t)
    return exponent.astype(kind) * math.log(2) + t * series


def _turned(word: Words, kind: np.dtype) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    r"""Cosine and sine of the angle $2 \pi w / 2^{32}$, less an eighth of a turn."""
    quarter = word >> 30
    # Signed, since machines convert those faster.
    rest = (word & jnp.uint32(2**30 - 1)).astype(jnp.int32).astype(kind)
    x = (rest - (2**29 - 0.5)) * (math.pi / 2**31)
    x2 = x * x
    sine = x * _horner([(-1) ** k / math.factorial(2 * k + 1) for k in range(8)], x2)
    cosine = _horner([(-1) ** k / math.factorial(2 * k) for k in range(8)], x2)
    odd = (quarter & 1) == 1
    first, second = jnp.where(odd, sine, cosine), jnp.where(odd, cosine, sine)
    # Quarters 1 and 2 are those to the left, 2 and 3 those below.
    left, below = ((quarter + 1) & 2) == 2, (quarter & 2) == 2
    return jnp.where(left, -first, first), jnp.where(below, -second, second)


def _horner(coefficients: list[float], x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value
