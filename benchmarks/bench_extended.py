"""The extended filter beside FilterPy: same model, same log, same run, same result.

FilterPy gets analytic Jacobians in NumPy and its readings as plain arrays; nothing is slowed
down for it. Both do the same events: a prediction at each, an update where a sensor fired.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

import kedge
from kedge.estimation.batch import compile_estimate, pass_over
from kedge.estimation.rig import as_arrays
from kedge.estimation.runs import estimate_runs
from kedge.simulation.simulate import schedule, simulate, with_readings

BATCH = 1000
SPEED_NOISE, YAW_RATE_NOISE, RANGE_STD, BEARING_STD, GNSS_STD = 0.1, 0.02, 0.5, 0.02, 1.0


@pytest.fixture(scope="module")
def scenario():
    vehicle = kedge.make_vehicle(
        "unicycle", speed_noise=SPEED_NOISE, yaw_rate_noise=YAW_RATE_NOISE
    )
    camera = kedge.make_sensor("landmarks", range_std=RANGE_STD, bearing_std=BEARING_STD)
    gnss = kedge.make_sensor("gnss", std=GNSS_STD)
    rig = kedge.Rig(
        vehicle,
        (kedge.Installation("camera", camera), kedge.Installation("gnss", gnss)),
        kedge.Gaussian(vehicle.start(), 0.1 * jnp.eye(3)),
    )
    return kedge.Scenario(rig, 60.0)


@pytest.fixture(scope="module")
def plan(scenario):
    return schedule(scenario, output_rate=1e-3)


def test_one_log(scenario, plan, times):
    extended = kedge.make_filter("extended")
    log = with_readings(plan.log, scenario, simulate(scenario, jax.random.key(0)))
    events = len(plan.stamps)
    call = compile_estimate(extended, scenario.rig, log, keep=False)
    (found, _), ours = times.best(lambda: jax.block_until_ready(call()), 20)
    rival, theirs = times.best(lambda: filterpy(scenario, log), 5)
    np.testing.assert_allclose(
        np.asarray(found.moments.mean.position)[-1], rival[:2], atol=1e-8
    )
    times.row("extended, one log", "FilterPy", theirs / events, ours / events, at_least=5)


def test_batch(scenario, plan, times):
    extended = kedge.make_filter("extended")
    runs = jax.jit(jax.vmap(lambda key: simulate(scenario, key)))(
        jax.random.split(jax.random.key(1), BATCH)
    )
    logs = jax.vmap(lambda run: with_readings(plan.log, scenario, run)._replace(schedule=None))(
        runs
    )._replace(schedule=plan.log.schedule)
    events = len(plan.stamps)

    def ours():
        return jax.block_until_ready(estimate_runs(extended, scenario.rig, logs, keep=last))

    ours()
    found, seconds = times.best(ours, 5)
    first = with_readings(plan.log, scenario, jax.tree.map(lambda leaf: leaf[0], runs))
    rival, theirs = times.best(lambda: filterpy(scenario, first), 5)
    np.testing.assert_allclose(np.asarray(found.mean.position)[0], rival[:2], atol=1e-8)
    times.note(f"conditionals in the compiled batch: {conditionals(extended, scenario, logs)}")
    name = f"extended, batch of {BATCH}"
    times.row(name, "FilterPy", theirs / events, seconds / events / BATCH, at_least=100)


def last(estimates):
    """What FilterPy leaves as well: the belief at the end."""
    return jax.tree.map(lambda leaf: leaf[-1], estimates.moments)


def conditionals(extended, scenario, logs):
    """Branches in the program: one for the time step, one for the sensor."""
    extended, rig, logs = as_arrays((extended, scenario.rig, logs))

    def one(controls, readings):
        own = logs._replace(controls=controls, readings=readings)
        return pass_over(extended, rig, own, jax.random.key(0), False)[0].moments

    program = jax.jit(jax.vmap(one)).lower(logs.controls, logs.readings).compile()
    return program.as_text().count(" conditional(")


def filterpy(scenario, log):
    """The same filter by FilterPy; returns the last state."""
    landmarks = np.asarray(scenario.rig.sensors[0].sensor.target.position)
    time, sensor, row = (np.asarray(v).tolist() for v in log.schedule)
    speed, yaw_rate = (np.asarray(v).tolist() for v in log.controls)
    camera, gnss = log.readings
    sightings = np.stack([np.asarray(v) for v in camera.measurement], axis=1)
    targets, fixes = np.asarray(camera.target), np.asarray(gnss.measurement.position)
    camera_cov, gnss_cov = np.diag([RANGE_STD**2, BEARING_STD**2]), np.eye(2) * GNSS_STD**2
    select = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

    def wrapped(z, expected):
        residual = z - expected
        residual[1] = (residual[1] + math.pi) % (2 * math.pi) - math.pi
        return residual

    def sight(x, landmark):
        east, north = landmark - x[:2]
        return np.array([math.hypot(east, north), math.atan2(north, east) - x[2]])

    def sight_jacobian(x, landmark):
        east, north = landmark - x[:2]
        squared = east**2 + north**2
        r = math.sqrt(squared)
        return np.array(
            [[-east / r, -north / r, 0.0], [north / squared, -east / squared, -1.0]]
        )

    ekf = ExtendedKalmanFilter(3, 2)
    ekf.x = np.asarray([*scenario.rig.prior.mean.position, scenario.rig.prior.mean.heading])
    ekf.P = np.asarray(scenario.rig.prior.cov).copy()
    motion = {}

    def move(u=0):
        ekf.x = np.array(
            [
                ekf.x[0] + motion["chord"] * math.cos(motion["course"]),
                ekf.x[1] + motion["chord"] * math.sin(motion["course"]),
                ekf.x[2] + motion["turn"],
            ]
        )

    ekf.predict_x = move
    last = 0.0
    for t, which, r, v, w in zip(time, sensor, row, speed, yaw_rate, strict=True):
        dt = t - last
        if dt > 0:
            turn = w * dt
            half = turn / 2
            sinc = math.sin(half) / half if abs(half) > 1e-9 else 1.0
            slope = (math.cos(half) - sinc) / turn if abs(half) > 1e-9 else 0.0
            chord, course = v * dt * sinc, ekf.x[2] + half
            cos, sin = math.cos(course), math.sin(course)
            ekf.F = np.array(
                [[1.0, 0.0, -chord * sin], [0.0, 1.0, chord * cos], [0.0, 0.0, 1.0]]
            )
            bent = v * dt * dt * slope
            spread = np.array(
                [
                    [sinc * dt * cos, bent * cos - chord * sin * dt / 2],
                    [sinc * dt * sin, bent * sin + chord * cos * dt / 2],
                    [0.0, dt],
                ]
            ) * (np.array([SPEED_NOISE, YAW_RATE_NOISE]) / math.sqrt(dt))
            ekf.Q = spread @ spread.T
            motion.update(chord=chord, course=course, turn=turn)
            ekf.predict()
        if which == 0:
            place = landmarks[targets[r]]
            ekf.update(
                sightings[r], sight_jacobian, sight, camera_cov, (place,), (place,), wrapped
            )
        elif which == 1:
            ekf.update(fixes[r], lambda x: select, lambda x: x[:2], gnss_cov)
        last = t
    return ekf.x
