"""Guidance against scipy's Riccati solver, the poles it places and the turns it holds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from kedge.simulation.guidance import follow, lane_keeper, like, regulator, steady_turn
from kedge.simulation.routes import Circle
from kedge.vehicles.lateral_tracking import (
    Control,
    LateralTracking,
    LinearLateralTracking,
    Noise,
    State,
)

CALM = Noise(*map(jnp.asarray, (0.0, 0.0, 0.0)))
CAR = LateralTracking()


@pytest.fixture(scope="module")
def keeper():
    return jax.jit(lambda: lane_keeper(CAR, 0.02, 0.3, 0.05, 0.03, 0.1, 0.5))()


def held(dt):
    A, B = (np.asarray(part) for part in LinearLateralTracking().system())
    whole = scipy.linalg.expm(np.block([[A, B], [np.zeros((5, 10))]]) * dt)
    return whole[:4, :4], whole[:4, 5:6]


def test_the_gain_solves_riccatis_equation(keeper):
    """Of scipy, and as the specification has it to its digits."""
    F, G = held(0.02)
    Q, R = np.diag([0.0, 0.0, 1 / 0.3**2, 1 / 0.05**2]), np.array([[1 / 0.03**2]])
    P = scipy.linalg.solve_discrete_are(F, G, Q, R)
    expected = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)[0]
    np.testing.assert_allclose(keeper.gains, expected, rtol=1e-9)
    np.testing.assert_allclose(keeper.gains, [0.0419, 0.1547, 0.0947, 2.460], rtol=1e-3)
    poles = np.log(np.linalg.eigvals(F - G @ np.asarray(keeper.gains)[None])) / 0.02
    wanted = [-2.48 + 4.50j, -2.39 + 2.00j]
    np.testing.assert_allclose(sorted(poles[poles.imag > 0], key=np.real), wanted, atol=6e-3)


def test_several_inputs():
    draws = np.random.default_rng(1)
    F, G = np.eye(3) + 0.1 * draws.normal(size=(3, 3)), draws.normal(size=(3, 2))
    Q, R = np.diag([1.0, 2.0, 0.5]), np.diag([0.3, 2.0])
    P = scipy.linalg.solve_discrete_are(F, G, Q, R)
    expected = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)
    found = jax.jit(regulator)(*map(jnp.asarray, (F, G, Q, R)))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_steady_turn_stays_what_it_is():
    """At R = 800 m as the specification has it; and nothing changes when it is driven."""
    curve = 1 / 800
    state, steering = steady_turn(CAR, curve)
    assert round(float(steering) / curve, 3) == 13.516
    assert round(float(state.lateral_velocity) / curve, 1) == -537.7
    assert round(float(state.heading_error) / curve, 2) == 13.44
    assert float(state.yaw_rate) == pytest.approx(40 * curve)
    linear = like(CAR, LinearLateralTracking)
    control = Control(steering, jnp.asarray(0.0), jnp.asarray(curve))
    after = linear.step(state, control, CALM, 0.02)
    np.testing.assert_allclose(np.stack(after), np.stack(state), atol=1e-12)


def test_commands_stop_at_the_limit_and_vanish_in_the_turn(keeper):
    curve = jnp.asarray(1 / 800)
    state, ahead = steady_turn(CAR, curve)
    steering, acceleration = keeper.command(state, curve)
    np.testing.assert_allclose([steering, acceleration], np.array([ahead, 0.0]), atol=1e-15)
    far = state._replace(offset=jnp.asarray(-9.0), speed_error=jnp.asarray(2.0))
    np.testing.assert_allclose(keeper.command(far, curve), [0.1, -1.0])


def test_following_leads_back_exponentially():
    """An error shrinks with the gains, also across the seam of the heading."""
    route, dt = Circle(period=20.0), 1e-3

    def step(carry, time):
        position, heading = carry
        velocity, rate = follow(route.at(time), position, heading, 1.0, 2.0)
        return (position + velocity * dt, heading + rate * dt), None

    start = route.at(0.0)
    first = start.position + jnp.array([0.3, -0.1]), start.heading + 2 * np.pi + 0.5
    times = jnp.arange(2000) * dt
    position, heading = jax.jit(lambda: jax.lax.scan(step, first, times)[0])()
    end = route.at(2.0)
    left = np.exp(-2.0) * np.array([0.3, -0.1])
    np.testing.assert_allclose(position - end.position, left, atol=5e-4)
    assert float(heading - end.heading) - 2 * np.pi == pytest.approx(
        0.5 * np.exp(-4.0), abs=5e-5
    )


def test_another_form_of_the_same_car():
    car = LateralTracking(speed=20.0, mass=900.0, lateral_noise=0.2)
    other = like(car, LinearLateralTracking)
    assert (other.speed, other.mass, other.lateral_noise) == (20.0, 900.0, 0.2)
    assert like(other, LateralTracking) == car
    assert isinstance(car.start(), State)
