"""Whether a traced function is affine, decided from its program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.rotations import wrap
from kedge.numerics.linearity import is_affine

MATRIX = np.arange(6.0).reshape(2, 3)
AFFINE = {
    "matrix": lambda x: MATRIX @ x + 1,
    "jitted": jax.jit(lambda x: MATRIX @ x),
    "slices": lambda x: jnp.stack([x[0] - 2 * x[2], x[1] / 3]),
    "constant": lambda x: jnp.ones(2),
}
NONLINEAR = {
    "product": lambda x: x[:1] * x[1:2],
    "sine": jnp.sin,
    "jitted": jax.jit(jnp.cos),
    "square": lambda x: x**2,
    "length": lambda x: jnp.hypot(x[0], x[1])[None],
    "angle": lambda x: wrap(x[0])[None],  # it jumps, if seldom
    "branch": lambda x: jnp.where(x > 0, x, 2 * x),
    "scan": lambda x: jax.lax.fori_loop(0, 2, lambda _, y: y * y, x),
}


@pytest.mark.parametrize("name", AFFINE)
def test_affine(name):
    assert is_affine(AFFINE[name], jnp.array([0.1, 0.2, 0.3]))


@pytest.mark.parametrize("name", NONLINEAR)
def test_nonlinear(name):
    """Also at a point where the slope happens to be that of a line."""
    assert not is_affine(NONLINEAR[name], jnp.zeros(3))
    assert not is_affine(NONLINEAR[name], jnp.array([0.1, 0.2, 0.3]))
