"""Inertial navigation on the earth, against motions and periods that are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.core.manifolds import space_of
from kedge.numerics.earth import EARTH_RATE, Origin, earth_spin, gravity, radii
from kedge.testing import quick_jit
from kedge.vehicles.strapdown import Imu, ImuWithSlopes, State, Strapdown
from kedge.vehicles.strapdown_geodetic import GeodeticStrapdown

LEVEL = jnp.array([1.0, 0.0, 0.0, 0.0])
CALM = Imu(jnp.zeros(3), jnp.zeros(3))
SCHULER = 2 * np.pi * np.sqrt(6371e3 / 9.81)  # s; 84.4 min


def drive(vehicle, start, imu, dt):
    """The states after every step under readings with a leading axis."""

    def body(state, reading):
        after = vehicle.step(state, reading, CALM, dt)
        return after, after

    return quick_jit(lambda first, told: jax.lax.scan(body, first, told)[1])(start, imu)


def constant(force, rate, count):
    return Imu(
        jnp.tile(jnp.asarray(force), (count, 1)), jnp.tile(jnp.asarray(rate), (count, 1))
    )


def standing(latitude, height=0.0):
    """What an IMU reads that stands on the turning earth, its axes to the east, north, up."""
    return jnp.array([0.0, 0.0, gravity(latitude, height)]), earth_spin(latitude)


@pytest.mark.parametrize("latitude", [0.0, -1.2])
def test_an_hour_of_standing_is_no_motion(latitude):
    """To the second order in what the earth turns in a step, which is what is left out."""
    vehicle, dt = GeodeticStrapdown(latitude=latitude), 0.1
    start = State(jnp.zeros(3), jnp.zeros(3), LEVEL)
    after = drive(vehicle, start, constant(*standing(latitude), 36000), dt)
    assert np.abs(after.position).max() < 0.02
    assert np.abs(after.velocity).max() < 1e-4
    assert np.abs(np.asarray(after.attitude) - LEVEL[None]).max() < 1e-9


def test_an_hour_of_a_swinging_ship_ends_on_its_course():
    """North speed 5 sin(2 pi t / 600) m/s on the level: what an IMU reads follows by hand."""
    vehicle, dt, count = GeodeticStrapdown(latitude=0.8), 0.05, 72000
    middles, beat = (np.arange(count) + 0.5) * dt, 2 * np.pi / 600
    speed = 5 * np.sin(beat * middles)
    ends = np.arange(1, count + 1) * dt
    gain = 5 * (np.sin(beat * ends) - np.sin(beat * (ends - dt)))
    north = 5 / beat * (1 - np.cos(beat * middles))

    @quick_jit
    @jax.vmap
    def read(speed, push, north):
        latitude = Origin(0.8).from_map(jnp.stack([0.0, north, 0.0]))[0]
        spin, zero = earth_spin(latitude), jnp.zeros(())
        transport = jnp.stack([-speed / radii(latitude).meridian, zero, zero])
        force = jnp.stack([zero, push, gravity(latitude, 0.0)])
        velocity = jnp.stack([zero, speed, zero])
        return Imu(force + jnp.cross(2 * spin + transport, velocity), spin + transport)

    start = State(jnp.zeros(3), jnp.zeros(3), LEVEL)
    after = drive(vehicle, start, read(*map(jnp.asarray, (speed, gain / dt, north))), dt)
    assert np.abs(after.position[:, 1] - 5 / beat * (1 - np.cos(beat * ends))).max() < 0.02
    assert np.abs(np.asarray(after.position)[:, [0, 2]]).max() < 0.02
    assert np.abs(np.asarray(after.attitude) - LEVEL[None]).max() < 1e-8


def test_a_flat_map_that_turns_with_the_earth_stands_still():
    vehicle = Strapdown(earth=True, latitude=0.8)
    readings = constant([0.0, 0.0, vehicle.gravity], earth_spin(0.8), 600)
    after = drive(vehicle, State(jnp.zeros(3), jnp.zeros(3), LEVEL), readings, 0.1)
    assert np.abs(after.position).max() < 1e-7
    blind = drive(Strapdown(), State(jnp.zeros(3), jnp.zeros(3), LEVEL), readings, 0.1)
    # Without the earth's rate it tilts: g w cos(L) t^3 / 6, to the east or west.
    expected = 9.81 * EARTH_RATE * np.cos(0.8) * 60**3 / 6
    assert abs(blind.position[-1, 0]) == pytest.approx(expected, rel=0.01)


def test_a_velocity_error_swings_with_schulers_period():
    """At the equator; the period is 2 pi sqrt((R + h) / g), 84.4 min."""
    count, dt = 5400, 1.0
    start = State(jnp.zeros(3), jnp.array([0.0, 0.01, 0.0]), LEVEL)
    after = drive(GeodeticStrapdown(latitude=0.0), start, constant(*standing(0.0), count), dt)
    north = np.asarray(after.position[:, 1])
    crossings = np.flatnonzero(np.diff(np.sign(north)) != 0)
    back = crossings[0] + north[crossings[0]] / (north[crossings[0]] - north[crossings[0] + 1])
    period = 2 * np.pi * np.sqrt(radii(0.0).meridian / gravity(0.0, 0.0))
    assert 2 * (back + 1) * dt == pytest.approx(float(period), rel=2e-3)
    assert float(period) / 60 == pytest.approx(84.4, abs=0.6)


@pytest.mark.parametrize("speed", [0.0, 20.0])
def test_the_linear_errors_are_those_of_the_mechanisation_over_a_schuler_period(speed):
    """What -g/R position terms in a phi-angle model get wrong by 60 % and more."""
    latitude, dt, count = 0.8, 4.0, round(SCHULER / 4.0)
    vehicle, states = GeodeticStrapdown(latitude=latitude), space_of(State)
    begin = State(jnp.zeros(3), jnp.array([speed, 0.0, 0.0]), LEVEL)

    def held(state):
        """Readings under which velocity and attitude stay as they are, on the level."""
        place = Origin(latitude).from_map(state.position)
        meridian, transverse = radii(place[0])
        v, spin = state.velocity, earth_spin(place[0])
        transport = jnp.stack(
            [-v[1] / meridian, v[0] / transverse, v[0] * jnp.tan(place[0]) / transverse]
        )
        pull = jnp.stack([0.0, 0.0, gravity(place[0], place[2])])
        return Imu(pull + jnp.cross(2 * spin + transport, v), spin + transport)

    def step(state, readings, error_of_imu):
        told = Imu(
            readings.specific_force + error_of_imu[:3], readings.angular_rate + error_of_imu[3:]
        )
        return vehicle.step(state, told, CALM, dt)

    def body(carry, _):
        state, wrong, slope = carry
        readings = held(state)
        after = step(state, readings, jnp.zeros(6))

        def moved(error):
            return states.boxminus(
                step(states.boxplus(state, error[:9]), readings, error[9:]), after
            )

        F = jax.jacfwd(moved)(jnp.zeros(15))
        slope = jnp.concatenate([F @ slope, jnp.eye(15)[9:]])
        wrong = jax.vmap(lambda s, e: step(s, readings, e))(wrong, errors[:, 9:])
        apart = jax.vmap(lambda s: states.boxminus(s, after))(wrong)
        return (after, wrong, slope), (apart, errors @ slope[:9].T)

    sizes = [*[1.0] * 3, *[0.01] * 3, *[1e-5] * 3, *[1e-4] * 3, *[1e-8] * 3]
    # Height diverges by itself; what is compared is the level motion.
    errors = jnp.diag(jnp.array(sizes))[jnp.array([0, 1, 3, 4, 6, 7, 8, 9, 10, 12, 13, 14])]

    @quick_jit
    def run():
        wrong = jax.vmap(lambda e: states.boxplus(begin, e[:9]))(errors)
        return jax.lax.scan(body, (begin, wrong, jnp.eye(15)), None, count)[1]

    nonlinear, linear = (np.asarray(found)[..., :2] for found in run())
    size = np.linalg.norm(nonlinear, axis=-1).max(axis=0)
    gap = np.linalg.norm(nonlinear - linear, axis=-1).max(axis=0)
    assert (gap <= 0.01 * size).all(), gap / size


def coning(half_angle, rate, dt, count):
    """Increments of a body whose axis describes a cone, and its slopes; the exact attitude."""
    ends = np.arange(count + 1) * dt
    swing = half_angle * np.stack([np.sin(rate * ends), -np.cos(rate * ends), 0 * ends], axis=1)
    mean = np.diff(swing, axis=0) / dt
    fine = 50
    times = (np.arange(count * fine) + 0.5) * dt / fine
    turning = (
        half_angle * rate * np.stack([np.cos(rate * times), np.sin(rate * times), 0 * times], 1)
    )
    exact = Rotation.identity()
    steps = Rotation.from_rotvec(turning * dt / fine)
    for one in range(count * fine):
        exact = exact * steps[one]
    return mean, exact


def test_coning_drifts_by_its_closed_form_and_is_compensated():
    """One sample a step: (1/2) a^2 W (1 - sin(W dt) / (W dt)); with slopes 50 times less."""
    half_angle, rate, dt, count = np.radians(1.0), 2 * np.pi * 10, 0.005, 100
    mean, exact = coning(half_angle, rate, dt, count)
    start = State(jnp.zeros(3), jnp.zeros(3), LEVEL)
    force = np.zeros_like(mean)
    plain = drive(Strapdown(), start, Imu(jnp.asarray(force), jnp.asarray(mean)), dt)
    before = np.concatenate([2 * mean[:1] - mean[1:2], mean[:-1]])
    slopes = ImuWithSlopes(*map(jnp.asarray, (force, mean, force, (mean - before) / dt)))
    better = drive(Strapdown(slopes=True), start, slopes, dt)

    def drift(after):
        found = Rotation.from_quat(np.roll(np.array(after.attitude[-1]), -1))
        return (exact.inv() * found).as_rotvec()[2] / (dt * count)

    expected = half_angle**2 * rate / 2 * (1 - np.sin(rate * dt) / (rate * dt))
    assert expected == pytest.approx(1.566e-4, rel=1e-3)
    assert abs(drift(plain)) == pytest.approx(expected, rel=0.01)
    assert abs(drift(better)) < expected / 40


def test_a_half_turn_leaves_nothing_across():
    """100 m/s, 18 deg/s: a velocity that is pushed in the old axes is 0.314 m off after it."""
    speed, rate, dt = 100.0, np.radians(18.0), 0.01
    count = round(np.pi / rate / dt)
    readings = constant([0.0, speed * rate, 9.81], [0.0, 0.0, rate], count)
    start = State(jnp.zeros(3), jnp.array([speed, 0.0, 0.0]), LEVEL)
    after = drive(Strapdown(), start, readings, dt)
    np.testing.assert_allclose(after.velocity[-1], [-speed, 0, 0], atol=1e-6)
    radius = speed / rate
    assert abs(float(after.position[-1, 0])) < 1e-5
    assert float(after.position[-1, 1]) == pytest.approx(2 * radius, rel=1e-6)
