import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from kedge.numerics.exponential import held_inputs


@pytest.mark.parametrize("scale", [0.1, 1.0, 5.0])
def test_steps_of_linear_systems_are_those_of_the_library(scale):
    rng = np.random.default_rng(0)
    A, B, dt = scale * rng.normal(size=(5, 5)), rng.normal(size=(5, 3)), 0.3
    whole = scipy.linalg.expm(np.block([[A, B], [np.zeros((3, 8))]]) * dt)
    F, G = held_inputs(jnp.asarray(A), jnp.asarray(B), dt)
    np.testing.assert_allclose(F, whole[:5, :5], rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(G, whole[:5, 5:], rtol=1e-11, atol=1e-13)


def test_no_time_is_no_step():
    F, G = held_inputs(jnp.ones((2, 2)), jnp.ones((2, 1)), 0.0)
    np.testing.assert_array_equal(F, np.eye(2))
    np.testing.assert_array_equal(G, np.zeros((2, 1)))
