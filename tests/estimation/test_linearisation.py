"""A rig as a linear system: against a model that is linear, and against its own step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from kedge.config.scenarios import load_scenario
from kedge.core.errors import ContractError, DataError
from kedge.core.manifolds import space
from kedge.estimation.linearisation import LinearSystem, linearise


@pytest.fixture(scope="module")
def rig():
    return load_scenario("agv-lateral").scenario.rig


@pytest.fixture(scope="module")
def system(rig):
    return linearise(rig)


def test_a_linear_model_is_what_its_step_integrates(rig, system):
    """Its step is Runge and Kutta's: of 2 ms, right to (6 dt)^5 / 120 = 2e-12."""
    vehicle, state = rig.vehicle, rig.prior.mean
    control = jax.tree.map(jnp.zeros_like, vehicle.nominal_control(jnp.zeros(())))
    still = jax.tree.map(jnp.zeros_like, vehicle.noise_density())
    states, inputs = space(state), space(control)

    def step(error, turned):
        begin, driven = states.boxplus(state, error), inputs.boxplus(control, turned)
        after = vehicle.step(begin, driven, still, 0.002)
        return states.boxminus(after, state)

    F, G = jax.jacfwd(step, argnums=(0, 1))(states.zeros(), inputs.zeros())
    discrete = system.discretised(0.002)
    np.testing.assert_allclose(discrete.F, F, atol=2e-11)
    np.testing.assert_allclose(discrete.G, G, atol=2e-11)


def test_noise_over_a_step_is_the_integral(system):
    def grown(seconds):
        F = expm(system.A * seconds)
        return F @ system.Q @ F.T

    expected, _ = quad_vec(grown, 0, 0.3)
    np.testing.assert_allclose(system.discretised(0.3).Q, expected, rtol=1e-8, atol=1e-15)


def test_names_and_shapes(system):
    assert system.states[:2] == ("lateral_velocity", "yaw_rate")
    assert system.outputs == ("camera.offset", "camera.heading_error", "camera.speed_error")
    assert (system.C.shape, system.D.shape, system.R.shape) == ((3, 5), (3, 3), (3, 3))
    np.testing.assert_allclose(system.C @ np.arange(5.0), [2, 3, 4])


def made(A, B, C):
    n, u, z = len(A), np.shape(B)[1], len(C)
    return LinearSystem(
        tuple("abcd"[:n]), tuple("u"), tuple("z"), np.array(A, float), np.array(B, float),
        np.array(C, float), np.zeros((z, u)), np.zeros((n, n)), np.eye(z),
    )  # fmt: skip


def test_ranks_name_what_they_miss():
    """A chain a' = b, b' = u, and c by itself: u moves a and b, a tells of a and b."""
    chain = made([[0, 1, 0], [0, 0, 0], [0, 0, -1]], [[0], [1], [0]], [[1, 0, 0]])
    assert chain.controllability() == (2, ("c",))
    assert chain.observability() == (2, ("c",))
    blind = chain._replace(C=np.array([[0.0, 1.0, 0.0]]))
    assert blind.observability() == (1, ("a", "c"))


def test_a_rank_does_not_hang_on_units():
    """Fast and slow parts, 1e6 apart: powers of A would lose the slow ones."""
    A = np.diag([1e3, 1.0, 1e-3])
    assert made(A, [[1], [1], [1]], [[1, 1, 1]]).controllability().rank == 3


def test_a_step_must_last(system):
    with pytest.raises(DataError, match="dt: found -1 s"):
        system.discretised(-1.0)


def test_a_state_or_control_of_another_vehicle_is_refused(rig):
    with pytest.raises(ContractError, match="state: found list, expected State"):
        linearise(rig, [1.0] * 5)
    with pytest.raises(ContractError, match="control: found State"):
        linearise(rig, control=rig.prior.mean)
    lost = rig.prior.mean._replace(offset=jnp.array(jnp.nan))
    with pytest.raises(DataError, match="expected finite numbers"):
        linearise(rig, lost)
