"""What control theory says of the lateral model at 40 m/s, by numpy and scipy.

The figures are those of an independent computation; the printed matrices are paper A's.
"""

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


def system(speed=40.0):
    """A, and B by steering and acceleration."""
    A, B = (np.asarray(part) for part in LinearLateralTracking(speed=speed).system())
    return A, B[:, [0, 4]]


def rank_of(A, B):
    """Of what the inputs reach, blocks scaled so that rounding does not count."""
    scale = np.linalg.norm(A, 2)
    blocks = [np.linalg.matrix_power(A / scale, i) @ B for i in range(len(A))]
    reach = np.hstack([block / np.linalg.norm(B) for block in blocks])
    return np.linalg.matrix_rank(reach, tol=1e-9)


def test_natural_frequency_damping_and_understeer():
    A, _ = system()
    poles = np.linalg.eigvals(A[:2, :2])
    frequency = abs(poles[0])
    assert round(frequency, 3) == 4.663
    assert round(-poles[0].real / frequency, 3) == 0.464
    m, front, rear, arms = 1500.0, 55_000.0, 65_000.0, (1.1, 1.6)
    understeer = m * (arms[1] * rear - arms[0] * front) / (sum(arms) * front * rear)
    assert round(understeer, 5) == 0.00676
    # The speed at which the yaw gain of the model itself is largest.
    speeds = np.linspace(5, 60, 5501)

    def yaw_gain(speed):
        tyres = np.asarray(LinearLateralTracking(speed=float(speed)).tyres())
        return -np.linalg.solve(tyres[:, :2], tyres[:, 2])[1]

    gains = [yaw_gain(speed) for speed in speeds[::50]]
    assert abs(speeds[::50][np.argmax(gains)] - 20.0) <= 0.5
    assert abs(np.sqrt(sum(arms) / understeer) - 20.0) < 0.05


def test_what_can_be_controlled():
    A, B = system()
    assert rank_of(A, B[:, :1]) == 4  # the speed is not steered
    assert rank_of(A, B) == 5


@pytest.mark.parametrize(
    ("measured", "rank"),
    [
        (("offset", "heading_error", "speed_error"), 5),
        (("offset", "speed_error"), 5),
        (("heading_error", "speed_error"), 4),  # the offset is lost
        (("offset", "heading_error"), 4),
        (("offset",), 4),
    ],
)
def test_what_can_be_observed(measured, rank):
    A, _ = system()
    C = np.eye(5)[[State._fields.index(name) for name in measured]]
    assert rank_of(A.T, C.T) == rank


def held(A, B, dt):
    whole = scipy.linalg.expm(np.block([[A, B], [np.zeros((B.shape[1], 7))]]) * dt)
    return whole[:5, :5], whole[:5, 5:]


def test_eulers_rule_is_wrong_where_inputs_that_are_held_are_not():
    A, B = system()
    limit = min(-2 * pole.real / abs(pole) ** 2 for pole in np.linalg.eigvals(A[:2, :2]))
    assert round(limit, 3) == 0.199
    slow, _ = system(0.6)
    poles = np.linalg.eigvals(slow[:2, :2])
    assert round(min(-2 * p.real / abs(p) ** 2 for p in poles), 4) == 0.0109

    def mode(F):
        return max(abs(np.linalg.eigvals(F[:2, :2])))

    assert round(mode(held(A, B, 0.1)[0]), 3) == 0.805
    assert round(mode(np.eye(5) + 0.1 * A), 3) == 0.886
    shares = {}
    for dt in (0.01, 0.02, 0.05, 0.1):
        exact, euler = held(A, B, dt)[1][:, 0], dt * B[:, 0]
        shares[dt] = np.abs(euler - exact).max() / np.abs(exact).max()
    found = [round(100 * share, 1) for share in shares.values()]
    assert found == [16.0, 37.5, 104.3, 207.2]  # per cent
    assert round(held(A, B, 0.1)[1][0, 0], 2) == -0.83
    assert round(0.1 * B[0, 0], 2) == 3.67


def test_the_speed_is_pushed_once_by_the_turn():
    """r v_y, and not the 2 r v_y that the printed A(t) x gives: 0.05 and not 0.10 m/s^2."""
    none = jnp.asarray(0.0)
    state = State(jnp.asarray(0.5), jnp.asarray(0.1), none, none, none)
    still = Control(none, none, none)

    def speed(dt):
        return LateralTracking().step(state, still, CALM, dt).speed_error

    assert float(jax.grad(speed)(0.0)) == pytest.approx(0.05)


def test_the_nonlinear_model_is_integrated_to_fourth_order():
    """Halving the step divides the error by 16, against steps that are far shorter."""
    state = State(*map(jnp.asarray, (2.0, 0.3, 1.0, 0.3, 0.5)))
    control = Control(*map(jnp.asarray, (0.05, -0.3, 1 / 100)))
    model = LateralTracking()

    @jax.jit
    def after(count):
        def step(_, at):
            return model.step(at, control, CALM, 0.2 / count)

        return jnp.stack(jax.lax.fori_loop(0, count, step, state))

    exact = after(4096)
    errors = [np.abs(after(count) - exact).max() for count in (8, 16, 32)]
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 4.0, atol=0.15)
