"""Chaotic systems: conserved quantities, fixed points, known divergence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.core.manifolds import space_of
from kedge.testing import quick_jit
from kedge.vehicles.benchmarks.autonomous import Control
from kedge.vehicles.benchmarks.lorenz63 import Lorenz63, State
from kedge.vehicles.benchmarks.lorenz96 import Lorenz96, ring


def test_advection_keeps_the_energy():
    """Without damping and forcing the sum of squares would stay: its rate is -2 E + F sum."""
    x = np.random.default_rng(0).normal(size=9)
    rate = np.asarray(Lorenz96(size=9, forcing=3.0).flow(jnp.asarray(x)))
    np.testing.assert_allclose(x @ rate, -x @ x + 3.0 * x.sum(), rtol=1e-12)
    # The equations look the same from every place on the ring.
    turned = Lorenz96(size=9, forcing=3.0).flow(jnp.asarray(np.roll(x, 4)))
    np.testing.assert_allclose(turned, np.roll(rate, 4), rtol=1e-12)


def test_fixed_points_rest():
    even = ring(5)(jnp.full(5, 8.0))
    np.testing.assert_allclose(
        Lorenz96(size=5).rates(even, Control(), ring(5)(jnp.zeros(5))), 0
    )
    wing = np.sqrt(8 / 3 * 27)
    for centre in ([0, 0, 0], [wing, wing, 27], [-wing, -wing, 27]):
        flow = Lorenz63().flow(jnp.asarray(centre, float))
        np.testing.assert_allclose(flow, 0, atol=1e-12)


def test_volumes_shrink_at_the_known_rate():
    """Divergence: minus (sigma + 1 + beta), and minus the size of the ring."""
    trace = np.trace(jax.jacfwd(Lorenz63().flow)(jnp.array([1.0, 2.0, 3.0])))
    np.testing.assert_allclose(trace, -(10 + 1 + 8 / 3))
    trace = np.trace(jax.jacfwd(Lorenz96(size=7).flow)(jnp.arange(7.0)))
    np.testing.assert_allclose(trace, -7)


def test_substeps_are_steps():
    start, calm = Lorenz63().start(), State(jnp.zeros(3))

    def both(start):
        state = start
        for _ in range(4):
            state = Lorenz63().step(state, Control(), calm, 0.01)
        return state, Lorenz63(substeps=4).step(start, Control(), calm, 0.04)

    one, other = quick_jit(both)(start)
    np.testing.assert_allclose(one.values, other.values, rtol=1e-13)


def test_one_class_for_each_size():
    assert type(Lorenz96(size=40).start()) is type(Lorenz96(size=40).start())
    assert type(Lorenz96(size=4).start()) is not type(Lorenz96(size=5).start())
    assert space_of(type(Lorenz96(size=1000).start())).size == 1000


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Lorenz96(size=3), "size is 3, must be at least 4"),
        (lambda: Lorenz63(substeps=0), "substeps is 0, must be at least 1"),
    ],
)
def test_bad_parameters(make, says):
    with pytest.raises(ContractError, match=says):
        make()
