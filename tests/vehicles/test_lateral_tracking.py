"""The lateral model against the numbers printed for it, and its two forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from kedge.vehicles.lateral_tracking import (
    Control,
    LateralTracking,
    LinearLateralTracking,
    Noise,
    State,
)

CALM = Noise(*map(jnp.asarray, (0.0, 0.0, 0.0)))


def vector(state):
    return np.array([float(field) for field in state])


def test_the_matrix_is_the_one_that_is_printed():
    """Paper A's six numbers at 40 m/s, its spectrum and its characteristic speed."""
    A, B = LinearLateralTracking().system()
    tyres = [[-2.0, -39.275], [0.435, -2.3297]]
    np.testing.assert_allclose(A[:2, :2], tyres, rtol=1e-3)
    np.testing.assert_allclose(B[:2, 0], [36.6667, 24.2], rtol=1e-3)
    poles = np.sort_complex(np.linalg.eigvals(A))
    np.testing.assert_allclose(poles[0], -2.1648 - 4.1301j, rtol=1e-4)
    np.testing.assert_allclose(poles[2:], 0.0, atol=1e-7)
    assert np.linalg.matrix_rank(A) == 3  # three zeros, one of them a chain of two


@pytest.mark.parametrize(
    ("speed", "pole"), [(5.0, -19.0), (2.0, -54.0), (0.6, -183.0)], ids=["5", "2", "0.6"]
)
def test_the_tyres_are_stiff_at_low_speed(speed, pole):
    A, _ = LinearLateralTracking(speed=speed).system()
    assert round(np.linalg.eigvals(A).real.min()) == pole


def test_inputs_are_held_exactly():
    model = LinearLateralTracking()
    A, B = (np.asarray(part) for part in model.system())
    state = State(*map(jnp.asarray, (0.3, -0.1, 0.5, 0.02, 0.4)))
    control = Control(*map(jnp.asarray, (0.02, -0.3, 1 / 800)))
    noise = Noise(*map(jnp.asarray, (0.4, -0.2, 0.1)))
    inputs = np.array([0.02, 1 / 800, 0.4, -0.2, -0.3 + 0.1])
    whole = scipy.linalg.expm(np.block([[A, B], [np.zeros((5, 10))]]) * 0.1)
    expected = whole[:5] @ np.concatenate([vector(state), inputs])
    found = model.step(state, control, noise, 0.1)
    np.testing.assert_allclose(vector(found), expected, rtol=1e-12, atol=1e-14)


def test_the_linear_model_is_the_slope_of_the_other_at_rest():
    linear, other = LinearLateralTracking(), LateralTracking()
    control = Control(*map(jnp.asarray, (0.0, 0.0, 0.0)))
    rest = State(*map(jnp.asarray, (0.0, 0.0, 0.0, 0.0, 0.0)))

    def slope(model):
        return jax.jacfwd(lambda s: jnp.stack(model.step(s, control, CALM, 1e-3)))(rest)

    for a, b in zip(slope(linear), slope(other), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


def test_a_steady_curve_has_a_heading_error():
    """R = 800 m: with steering 13.516 k the yaw rate is k v, and the body is turned."""
    curve = 1 / 800
    control = Control(*map(jnp.asarray, (13.516 * curve, 0.0, curve)))
    state = State(*map(jnp.asarray, (-537.7 * curve, 40 * curve, 0.0, 13.44 * curve, 0.0)))
    after = state
    for _ in range(50):
        after = LinearLateralTracking().step(after, control, CALM, 0.02)
    np.testing.assert_allclose(vector(after), vector(state), atol=2e-3)
