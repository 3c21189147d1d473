"""Planar vehicles against circles, straight lines and numerical integration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from kedge.testing import quick_jit
from kedge.vehicles import arc as arc_of
from kedge.vehicles import (
    bicycle,
    commanded,
    differential_drive,
    odometry,
    planar_twist,
    unicycle,
)
from kedge.vehicles.constant_velocity import ConstantVelocity
from kedge.vehicles.constant_velocity import Control as Nothing
from kedge.vehicles.constant_velocity import Noise as Acceleration
from kedge.vehicles.constant_velocity import State as Moving

Unicycle, Drive = unicycle.Unicycle, differential_drive.DifferentialDrive
TURNS = np.array([0.0, 1e-12, -1e-5, 0.3, -1.0, 3.0, 7.0])


def pose(x, y, heading):
    return unicycle.State(jnp.array([x, y]), jnp.asarray(heading))


def arc(yaw_rate):
    still = unicycle.Control(jnp.array(0.0), jnp.array(0.0))
    control = unicycle.Control(jnp.array(2.0), yaw_rate)
    return Unicycle().step(pose(1.0, -1.0, 0.5), control, still, 0.8)


def test_a_unicycle_drives_on_circles():
    """Complex integral of v exp(i heading): exact also for a turn of any size, and for none."""
    after = quick_jit(jax.vmap(arc))(TURNS)
    turn = TURNS * 0.8
    with np.errstate(invalid="ignore"):
        chord = np.where(turn == 0, 1.6, 1.6 * np.expm1(1j * turn) / (1j * turn))
    place = 1 - 1j + chord * np.exp(0.5j)
    np.testing.assert_allclose(
        np.asarray(after.position) @ [1, 1j], place, rtol=1e-14, atol=1e-14
    )
    np.testing.assert_allclose(
        np.exp(1j * after.heading), np.exp(1j * (0.5 + turn)), rtol=1e-13
    )


def test_a_unicycle_that_drives_straight_has_derivatives():
    # Half the arc's length times the time: where a small turn moves the end, sideways.
    slope = quick_jit(jax.jacfwd(lambda rate: arc(rate).position))(0.0)
    np.testing.assert_allclose(slope, 0.64 * np.array([-np.sin(0.5), np.cos(0.5)]), rtol=1e-12)


def test_scales_multiply_what_was_measured():
    still = unicycle.Control(jnp.array(0.0), jnp.array(0.0))
    control = unicycle.Control(jnp.array(2.0), jnp.array(0.5))
    larger = unicycle.Control(jnp.array(2.2), jnp.array(0.4))

    @quick_jit
    def both():
        scaled = Unicycle(speed_scale=1.1, yaw_rate_scale=0.8)
        return (
            scaled.step(pose(0.0, 0.0, 0.1), control, still, 0.3),
            Unicycle().step(pose(0.0, 0.0, 0.1), larger, still, 0.3),
        )

    one, other = both()
    np.testing.assert_allclose(one.position, other.position)
    np.testing.assert_allclose(one.heading, other.heading)


def test_two_wheels_make_a_unicycle():
    """v = (r + l) / 2 and the yaw rate (r - l) / b, for controls and for noise."""

    @quick_jit
    def both(wheels, slips):
        speed, rate = (wheels[0] + wheels[1]) / 2, (wheels[1] - wheels[0]) / 0.4
        noise = unicycle.Control((slips[0] + slips[1]) / 2, (slips[1] - slips[0]) / 0.4)
        one = Unicycle().step(pose(0.0, 0.0, 1.0), unicycle.Control(speed, rate), noise, 0.5)
        start = differential_drive.State(jnp.zeros(2), jnp.array(1.0))
        pair = differential_drive.Control
        two = Drive(track=0.4).step(start, pair(*wheels), pair(*slips), 0.5)
        return one, two

    for wheels in ([1.0, 1.2], [-0.3, 0.3], [0.5, 0.5]):
        one, two = both(np.array(wheels), np.array([0.02, -0.05]))
        np.testing.assert_allclose(one.position, two.position, atol=1e-15)
        np.testing.assert_allclose(one.heading, two.heading, atol=1e-15)


def test_constant_velocity_covers_its_distance():
    @quick_jit
    def end(acceleration):
        start = Moving(jnp.array([1.0, 2.0]), jnp.array([3.0, -1.0]))
        return ConstantVelocity().step(start, Nothing(), Acceleration(acceleration), 2.0)

    calm, pushed = end(np.zeros(2)), end(np.array([0.5, 0.0]))
    np.testing.assert_allclose(calm.position, [7, 0])
    np.testing.assert_allclose(calm.velocity, [3, -1])
    # Half an acceleration times the time squared.
    np.testing.assert_allclose(pushed.position - calm.position, [1, 0])
    np.testing.assert_allclose(pushed.velocity - calm.velocity, [1, 0])


@pytest.mark.parametrize("lag", [0.15, 1.0])
def test_commanded_motors_approach_their_goal(lag):
    """The yaw rate's lag and the heading are the solution of the differential equation."""
    vehicle = commanded.Commanded(
        speed_scale=0.9, turn_slowdown=0.1, yaw_rate_scale=1.2, yaw_per_metre=0.05, lag=lag
    )
    goal = 1.2 * 0.7 + 0.05 * 0.4

    def rates(_, state):
        return [state[1], (goal - state[1]) / lag]

    solution = scipy.integrate.solve_ivp(rates, (0, 0.6), [0.2, -0.5], rtol=1e-11, atol=1e-12)

    @quick_jit
    def end():
        start = commanded.State(jnp.zeros(2), jnp.array(0.2), jnp.array(-0.5))
        control = commanded.Control(jnp.array(0.4), jnp.array(0.7))
        calm = commanded.Noise(jnp.array(0.0), jnp.array(0.0), jnp.array(0.0))
        return vehicle.step(start, control, calm, 0.6)

    after = end()
    np.testing.assert_allclose(after.heading, solution.y[0, -1], rtol=1e-9)
    np.testing.assert_allclose(after.yaw_rate, solution.y[1, -1], rtol=1e-9)
    speed = 0.9 * 0.4 - 0.1 * 0.7
    np.testing.assert_allclose(np.linalg.norm(after.position), speed * 0.6)


def test_a_robot_that_stands_stays_where_it_is():
    @quick_jit
    def end(white):
        start = commanded.State(jnp.ones(2), jnp.array(0.2), jnp.array(0.0))
        still = commanded.Control(jnp.array(0.0), jnp.array(0.0))
        noise = commanded.Noise(white[0], white[1], jnp.array(0.0))
        return commanded.Commanded().step(start, still, noise, 0.6)

    after = end(np.array([3.0, -2.0]))
    np.testing.assert_array_equal(after.position, [1, 1])
    np.testing.assert_allclose(after.heading, 0.2, rtol=1e-15)


def chord_by_integration(pose, ahead, aside, turn):
    """Complex integral of the way, turned by the heading at each moment."""

    def rate(share, part):
        return part((ahead + 1j * aside) * np.exp(1j * (pose.heading + turn * share)))

    return sum(
        unit * scipy.integrate.quad(rate, 0, 1, (part,))[0]
        for unit, part in ((1, np.real), (1j, np.imag))
    )


@pytest.mark.parametrize("turn", [0.0, 1e-13, -0.3, 2.0, 7.0])
def test_an_arc_is_the_integral_of_its_twist(turn):
    begun = arc_of.State(jnp.array([1.0, -2.0]), jnp.asarray(0.4))
    along = quick_jit(lambda turn: arc_of.along_arc(begun, 0.8, -0.3, turn))
    place = 1 - 2j + chord_by_integration(begun, 0.8, -0.3, turn)
    after = along(turn)
    np.testing.assert_allclose(after.position, [place.real, place.imag], rtol=1e-12)
    np.testing.assert_allclose(np.exp(1j * after.heading), np.exp(1j * (0.4 + turn)))


def test_a_turn_of_next_to_nothing_has_the_derivative_of_none():
    begun = arc_of.State(jnp.zeros(2), jnp.asarray(0.0))
    slope = quick_jit(jax.jacfwd(lambda turn: arc_of.along_arc(begun, 1.0, 0.0, turn).position))
    for turn in (0.0, 1e-13, 3e-11):
        np.testing.assert_allclose(slope(turn), [0.0, 0.5], atol=1e-10)


def test_a_bicycle_drives_on_the_circle_of_its_steering():
    """Its rear axle is on a circle of the radius L / tan(delta), whatever the speed."""
    car = bicycle.Bicycle(wheelbase=2.0, steering_offset=0.05)
    control, calm = bicycle.Control(1.5, 0.35), bicycle.Control(0.0, 0.0)
    after = car.step(car.start(), control, calm, 1.0)
    radius = 2.0 / np.tan(0.3)
    np.testing.assert_allclose(
        after.position, [radius * np.sin(1.5 / radius), radius * (1 - np.cos(1.5 / radius))]
    )
    np.testing.assert_allclose(after.heading, 1.5 / radius)


@pytest.mark.parametrize(
    ("model", "control", "own"),
    [
        (Unicycle, unicycle.Control(0.0, 0.02), {}),
        (planar_twist.PlanarTwist, planar_twist.Control(0.0, 0.0, 0.02), {}),
        (Drive, differential_drive.Control(-0.005, 0.005), {}),
        (odometry.Odometry, odometry.Control(-5.0, 5.0), {}),
        (commanded.Commanded, commanded.Control(0.0, 0.02), {"lag": 1e-3}),
    ],
)
def test_a_bias_is_what_the_yaw_rate_reads_at_rest(model, control, own):
    """A turn of 0.02 rad/s that is all bias leaves the heading where it was."""
    vehicle = model(yaw_rate_bias=0.02, **own)
    calm = jax.tree.map(lambda leaf: 0.0 * jnp.asarray(leaf), vehicle.noise_density())
    after = vehicle.step(vehicle.start(), control, calm, 1.0)
    np.testing.assert_allclose(after.heading, 0.0, atol=1e-12)
