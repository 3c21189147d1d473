"""Quaternions and angles against scipy and complex numbers."""

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from kedge.core import rotations
from kedge.testing import quick_jit

RANDOM = np.random.default_rng(0)
VECTORS = RANDOM.normal(size=(50, 3))
LENGTHS = np.linalg.norm(VECTORS, axis=1, keepdims=True)
# Also the smallest turns, where exp and log are series, and those just short of half a turn.
TURNS = np.concatenate(
    [VECTORS]
    + [VECTORS[:10] / LENGTHS[:10] * angle for angle in (1e-9, 9e-7, 1.1e-6, 1e-3)]
    + [VECTORS[:10] / LENGTHS[:10] * (np.pi - gap) for gap in (1e-3, 1e-6, 1e-9)]
)


def quaternions(found: Rotation) -> np.ndarray:
    return found.as_quat()[:, [3, 0, 1, 2]]


def same_rotation(one, other):
    np.testing.assert_allclose(np.abs(np.sum(one * other, axis=1)), 1, atol=1e-14)


def test_exp_and_log_are_those_of_scipy():
    expected = Rotation.from_rotvec(TURNS)
    same_rotation(quick_jit(jax.vmap(rotations.exp))(TURNS), quaternions(expected))
    found = quick_jit(jax.vmap(rotations.log))(quaternions(expected))
    # Half a turn to the left is one to the right: compare what is left after undoing it.
    rest = (Rotation.from_rotvec(np.array(found)).inv() * expected).magnitude()
    np.testing.assert_allclose(rest, 0, atol=1e-12)
    assert np.linalg.norm(found, axis=1).max() <= np.pi


def test_product_and_rotation_are_those_of_scipy():
    p, q = Rotation.from_rotvec(TURNS), Rotation.from_rotvec(TURNS[::-1])
    found = quick_jit(jax.vmap(rotations.multiply))(quaternions(p), quaternions(q))
    same_rotation(found, quaternions(p * q))
    turned = quick_jit(jax.vmap(rotations.rotate))(quaternions(p), TURNS[::-1])
    np.testing.assert_allclose(turned, p.apply(TURNS[::-1]), atol=1e-13)
    back = quick_jit(jax.vmap(rotations.conjugate))(quaternions(p))
    same_rotation(back, quaternions(p.inv()))


def test_exp_and_log_have_derivatives_at_no_turn():
    there_and_back = jax.jacfwd(lambda v: rotations.log(rotations.exp(v)))
    at_rest = quick_jit(there_and_back)(np.zeros(3))
    np.testing.assert_allclose(at_rest, np.eye(3), atol=1e-15)


def test_the_slope_of_exp_is_the_derivative():
    """Of what is left of a turn that is a little larger, by automatic differentiation."""

    def left(more, turn):
        back = rotations.conjugate(rotations.exp(turn))
        return rotations.log(rotations.multiply(back, rotations.exp(turn + more)))

    # Around 1e-3, where the series begins, and up to nearly half a turn.
    lengths = [0.0, 1e-7, 9.9e-4, 1.1e-3, 0.3, 1.0, 3.0]
    turns = np.concatenate([VECTORS[:10] / LENGTHS[:10] * length for length in lengths])
    expected = quick_jit(jax.vmap(jax.jacfwd(left), (None, 0)))(np.zeros(3), turns)
    found = quick_jit(jax.vmap(rotations.exp_slope))(turns)
    np.testing.assert_allclose(found, expected, atol=1e-12)


ANGLES = np.concatenate(
    [
        RANDOM.uniform(-50, 50, 200),
        np.arange(-9, 10) * np.pi,
        np.nextafter(np.arange(-9, 10) * np.pi, 99),
        np.nextafter(np.arange(-9, 10) * np.pi, -99),
    ]
)


def test_wrap_is_the_angle_of_the_same_direction():
    wrapped = np.array(quick_jit(jax.vmap(rotations.wrap))(ANGLES))
    assert (wrapped >= -np.pi).all()
    assert (wrapped < np.pi).all(), "pi itself is -pi"
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * ANGLES), atol=1e-13)


def test_wrap_hides_no_gap_in_the_data():
    assert np.isnan(rotations.wrap(np.nan))


def test_wrap_has_slope_one_everywhere():
    np.testing.assert_array_equal(quick_jit(jax.vmap(jax.grad(rotations.wrap)))(ANGLES), 1)


def test_polar_is_a_complex_number():
    offsets = RANDOM.normal(size=(50, 2))
    length, angle = quick_jit(jax.vmap(rotations.polar))(offsets)
    np.testing.assert_allclose(length * np.exp(1j * angle), offsets @ [1, 1j], atol=1e-14)
    unit = quick_jit(jax.vmap(rotations.direction))(angle)
    np.testing.assert_allclose(unit * np.array(length)[:, None], offsets, atol=1e-14)


def test_polar_has_derivatives_at_the_origin():
    for slope in quick_jit(jax.jacfwd(rotations.polar))(np.zeros(2)):
        assert np.isfinite(slope).all()
