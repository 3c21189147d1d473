"""Normal numbers inside a compiled loop, beside NumPy's: time of all threads, a number."""

import time

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.numerics.random import fold_in, normals


@pytest.mark.parametrize("count", [600, 3000, 48_000])
def test_normal_numbers(count, times):
    repeats = 2_000_000 // count

    @jax.jit
    def ours(key):
        def body(total, number):
            return total + normals(fold_in(key, number), (count,)), None

        return jax.lax.scan(body, jnp.zeros(count), jnp.arange(repeats))[0]

    def rival():
        rng, total = np.random.default_rng(0), np.zeros(count)
        for _ in range(repeats):
            total += rng.standard_normal(count)
        return total

    key = jr.key(0)
    jax.block_until_ready(ours(key))
    # The rows alternate, so that what else the machine does falls on both.
    found = [
        times.best(call, 1, time.process_time)[1]
        for _ in range(5)
        for call in (lambda: jax.block_until_ready(ours(key)), rival)
    ]
    quick, slow = min(found[::2]), min(found[1::2])
    each = count * repeats
    times.row(f"normal numbers, {count} at a time", "NumPy", slow / each, quick / each)
