"""The exact slope of the hull's accelerations against automatic differentiation."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.vehicles.underwater.accelerations import accelerations
from kedge.vehicles.underwater.coefficient_files import as_coefficients
from kedge.vehicles.underwater.hydrodynamics import features, response


@pytest.mark.parametrize("name", ["remus100-derived", "torpedo-1m"])
def test_the_slope_is_that_of_automatic_differentiation(name):
    """By everything it depends on, at random points of either sign; backwards too."""
    reply = response(as_coefficients(name))

    def plain(*given):
        return given[0] @ features(*given[1:])

    keys = jr.split(jr.key(3), 3)
    points = [jr.normal(key, (20, size)) for key, size in zip(keys, (6, 3, 4), strict=True)]

    def slopes(function, *given):
        every = jax.jacfwd(function, (0, 1, 2, 3))(reply, *given)
        # By one alone, so that nothing else has a direction; and backwards.
        alone = jax.jacfwd(function, 1)(reply, *given)
        return every, alone, jax.jacrev(function, 1)(reply, *given)

    @jax.jit
    @jax.vmap
    def both(*given):
        return slopes(accelerations, *given), slopes(plain, *given)

    compared = jax.tree.map(lambda a, b: np.abs(a - b).max(), *both(*points))
    assert max(jax.tree.leaves(compared)) < 1e-12 * float(jnp.abs(reply).max())
