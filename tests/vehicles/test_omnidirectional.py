"""Four omnidirectional wheels against the closed forms of the symmetric robot."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.vehicles.omnidirectional import Control, Noise, Omnidirectional, State, Twist

ROBOT = Omnidirectional()
CALM = Noise(jnp.zeros(4), jnp.zeros(2), jnp.array(0.0))


def pose(x=0.0, y=0.0, heading=0.0):
    return State(jnp.array([x, y]), jnp.array(heading))


def test_the_symmetric_robot_in_closed_form():
    """J+ = r/2 [[0, -1, 0, 1], [1, 0, -1, 0], [1/(2R) ...]], and J rows by hand."""
    wheels = jnp.array([1.0, 2.0, -0.5, 0.7])
    twist = ROBOT.twist(wheels)
    half = 0.05 / 2
    np.testing.assert_allclose(
        twist.velocity, [half * (0.7 - 2.0), half * (1.0 + 0.5)], atol=1e-15
    )
    np.testing.assert_allclose(twist.yaw_rate, 0.05 / (4 * 0.2) * 3.2, atol=1e-15)
    rates = ROBOT.wheel_rates(Twist(jnp.array([0.3, -0.2]), jnp.array(0.5)))
    turn = 0.2 * 0.5
    expected = np.array([-0.2 + turn, -0.3 + turn, 0.2 + turn, 0.3 + turn]) / 0.05
    np.testing.assert_allclose(rates, expected, atol=1e-13)


def test_forward_undoes_inverse_for_any_angles():
    robot = Omnidirectional(angles=(0.1, 1.4, 2.9, 4.0), arm=0.3, radius=0.07)
    twist = Twist(jnp.array([0.3, -0.2]), jnp.array(0.5))
    back = robot.twist(robot.wheel_rates(twist))
    np.testing.assert_allclose(back.velocity, twist.velocity, atol=1e-14)
    np.testing.assert_allclose(back.yaw_rate, twist.yaw_rate, atol=1e-14)


def test_wheel_noise_spreads_evenly_whatever_the_heading():
    """A U A' = dt^2 r^2 s^2 diag(1/2, 1/2, 1/(4 R^2)) with the forward rule."""
    robot = Omnidirectional(rule="forward")

    def after(wheels, heading):
        state = robot.step(pose(heading=heading), Control(wheels), CALM, 0.1)
        return jnp.concatenate([state.position, state.heading[None]])

    for heading in (0.0, 0.7, 2.0):
        A = jax.jacfwd(after)(jnp.array([1.0, -2.0, 0.5, 3.0]), heading)
        expected = 0.1**2 * 0.05**2 * np.diag([0.5, 0.5, 1 / (4 * 0.2**2)])
        np.testing.assert_allclose(A @ A.T, expected, atol=1e-16)


@pytest.mark.parametrize(("rule", "order"), [("forward", 1), ("midpoint", 2), ("backward", 1)])
def test_a_circle_closes_with_the_order_of_the_rule(rule, order):
    """Facing its centre, once round: the radius after a lap, by the step's length."""
    robot = Omnidirectional(rule=rule)
    wheels = robot.wheel_rates(Twist(jnp.array([0.0, -0.5]), jnp.array(0.5)))

    def miss(steps):
        dt = 2 * np.pi / 0.5 / steps

        def body(state, _):
            return robot.step(state, Control(wheels), CALM, dt), None

        # A quarter of a lap: a full one closes by symmetry, whatever the rule.
        end, _ = jax.lax.scan(body, pose(), length=steps // 4)
        return np.linalg.norm(np.asarray(end.position) - [1.0, -1.0])

    assert miss(80) < 0.1
    np.testing.assert_allclose(miss(80) / miss(160), 2.0**order, rtol=0.1)


def test_the_mirrored_matrix_is_the_physical_one_with_the_heading_negated():
    wheels = Control(jnp.array([1.0, 2.0, -0.5, 0.7]))
    mirrored = Omnidirectional(kinematics="mirrored", rule="forward")
    one = mirrored.step(pose(heading=0.8), wheels, CALM, 0.1)
    other = Omnidirectional(rule="forward").step(pose(heading=-0.8), wheels, CALM, 0.1)
    np.testing.assert_allclose(one.position, other.position, atol=1e-16)
    np.testing.assert_allclose(one.heading - 0.8, other.heading + 0.8, atol=1e-15)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rule": "middle"}, "no rule called 'middle'"),
        ({"kinematics": "mirored"}, "no kinematics called 'mirored'.*did you mean 'mirrored'"),
        ({"angles": (0.0, 1.0, 2.0)}, "angles has 3 entries"),
        ({"angles": (0.0, math.pi, 0.0, math.pi)}, "cannot move the body in every direction"),
    ],
)
def test_robots_that_cannot_be(given, message):
    with pytest.raises(ContractError, match=message):
        Omnidirectional(**given)
