"""Random programs of a dozen operations, beside the same programs equation by equation."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from fixtures.machine_code import assert_both

pytest.importorskip("llvmlite")
STEPS = 12
ROW, MATRIX = (3,), (3, 3)

# Of a value x, another one y of its shape, a whole number i.
SAME_SHAPE = (
    lambda x, y, i: x + y,
    lambda x, y, i: x - 3 * y,
    lambda x, y, i: x * y,
    lambda x, y, i: -jnp.abs(x),
    lambda x, y, i: jnp.where(x < y, y, 2 - x),
    lambda x, y, i: jnp.floor(0.25 * x) + jnp.minimum(x, y) - jnp.sign(y),
    lambda x, y, i: jnp.where(i > 1, x[::-1], y),
    lambda x, y, i: x.at[1].add(y[0]).at[-1].set(2.0),
    lambda x, y, i: jnp.cumsum(x, axis=0) - jnp.max(y, axis=0, keepdims=True),
    lambda x, y, i: (
        jnp.roll(x, 1, axis=0) + lax.dynamic_update_slice(y, x[:1], (i, 0)[: x.ndim])
    ),
    lambda x, y, i: lax.switch(i, (jnp.add, jnp.subtract, lambda a, b: 2 * a), x, y),
    lambda x, y, i: lax.cond(x.sum() > y.sum(), lambda a: a + 1, lambda a: a * a, x),
    lambda x, y, i: lax.scan(lambda c, a: (a - c, c + a), y[0], x)[1],
    lambda x, y, i: lax.fori_loop(0, 3, lambda k, c: c + k * x, y),
    lambda x, y, i: x[jnp.clip(jnp.stack([i, i - 1, y[0].sum().astype(int) % 3]), 0, 2)],
    lambda x, y, i: jnp.where(jnp.isfinite(x) & ~(y > x), x, (x < 0) * y),
    lambda x, y, i: (x.astype(jnp.int32) << 1 ^ y.astype(jnp.int32)).astype(float),
)
TO_ROW = (
    lambda m, v, i: m @ v,
    lambda m, v, i: jnp.einsum("ij,ij->j", m, m.T) + m[i] - v,
    lambda m, v, i: m.sum(0) - v[jnp.argmax(m, axis=1)],
)
TO_MATRIX = (
    lambda m, v, i: m + v[:, None] * v[None, :],
    lambda m, v, i: m @ m.T,
    lambda m, v, i: jnp.concatenate([m[1:], v[None]]),
)
# These round, and do not jump.
SMOOTH = (
    lambda x, y: jnp.sin(x) + y,
    lambda x, y: jnp.cos(x * y),
    lambda x, y: jnp.exp(-(x**2)) - y,
    lambda x, y: jnp.arctan2(x, 2 + jnp.cos(y)),
    lambda x, y: jnp.log1p(y * y) - jnp.log(1.5 + jnp.sin(x)),
    lambda x, y: jnp.sqrt(1 + x * x) / (3 + jnp.tanh(y)),
    lambda x, y: jnp.hypot(x, 1.0) - jnp.tan(0.5 * jnp.sin(y)),
)


def whole_numbers(seed):
    """A program whose numbers stay whole and small: exact in any order of its sums."""

    def program(row, matrix, i):
        rng = np.random.default_rng(seed)
        rows, matrices = [row], [matrix]
        for _ in range(STEPS):
            values = (rows, matrices)[rng.integers(2)]
            x, y, m, v = (
                own[rng.integers(len(own))] for own in (values, values, matrices, rows)
            )
            kind = rng.integers(5)
            if kind == 0:
                values, new = rows, TO_ROW[rng.integers(len(TO_ROW))](m, v, i)
            elif kind == 1:
                values, new = matrices, TO_MATRIX[rng.integers(len(TO_MATRIX))](m, v, i)
            else:
                new = SAME_SHAPE[rng.integers(len(SAME_SHAPE))](x, y, i)
            values.append(jnp.clip(new, -30.0, 30.0))
        return [rows[-1], matrices[-1], *rows[1:3]]

    return program


def smooth(seed):
    def program(x, y):
        rng = np.random.default_rng(seed)
        values = [x, y]
        for _ in range(STEPS):
            a, b = (values[rng.integers(len(values))] for _ in range(2))
            values.append(SMOOTH[rng.integers(len(SMOOTH))](a, b))
        return values[-2:]

    return program


def seeds(fast, thorough):
    return [
        pytest.param(seed, marks=() if seed < fast else pytest.mark.slow)
        for seed in range(thorough)
    ]


@pytest.mark.parametrize("seed", seeds(2, 100))
def test_whole_numbers_are_exact(seed):
    rng = np.random.default_rng(seed)
    rows = [rng.integers(-3, 4, (7, *shape)).astype(float) for shape in (ROW, MATRIX)]
    assert_both(whole_numbers(seed), *rows, rng.integers(0, 3, 7), signs=False)


@pytest.mark.parametrize("seed", seeds(2, 60))
def test_smooth_functions_round(seed):
    rng = np.random.default_rng(seed)
    assert_both(smooth(seed), *rng.normal(0, 1, (2, 9)), rounds=True)


def test_each_step_alone():
    """So that each is tried, whatever is drawn above."""
    rng = np.random.default_rng(0)
    rows = [rng.integers(-3, 4, (7, *ROW)).astype(float) for _ in range(2)]
    whole = rng.integers(0, 3, 7)
    assert_both(lambda *xs: [step(*xs) for step in SAME_SHAPE], *rows, whole, signs=False)
