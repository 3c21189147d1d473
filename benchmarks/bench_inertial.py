"""The 15-state filter at 200 Hz beside a plain NumPy one, gtsam's navigation EKF and INSLIB.

All do the same events of one log: a prediction at each IMU sample, position and velocity at
5 Hz. gtsam's has 9 states, no biases, and is compiled C++ behind Python calls; INSLIB has 15,
in single precision, and is C behind ctypes. Both take one event a call, so what they cost is
the same offline and live. It is shown beside the others, not required.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge.estimation.batch import compile_estimate
from kedge.estimation.rig import Installation, Rig
from kedge.simulation.routes import FigureOfEight
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.simulation.worlds.measured_vehicle import MeasuredVehicle
from kedge.vehicles.augmented import Wander, augment

RATE, SECONDS = 200.0, 30.0
FORCE_NOISE, RATE_NOISE, RATE_WALK, FORCE_WALK = 3.92e-3, 8.73e-5, 2e-5, 2e-4
POSITION_STD, VELOCITY_STD = 0.5, 0.05


@pytest.fixture(scope="module")
def log():
    bare = kedge.make_vehicle(
        "strapdown", accelerometer_noise=FORCE_NOISE, gyroscope_noise=RATE_NOISE
    )
    slow = {"gyroscope_bias": Wander(RATE_WALK), "accelerometer_bias": Wander(FORCE_WALK)}
    vehicle = augment(bare, slow, [])
    world = MeasuredVehicle(FigureOfEight(), instability=False)
    start = world.motion(jnp.zeros(1))
    mean = vehicle.start()._replace(
        position=start[0][0], velocity=start[1][0], attitude=start[2][0]
    )
    std = jnp.repeat(jnp.array([0.5, 0.1, 0.02, 0.002, 0.03]), 3)
    sensors = (
        Installation(
            "gnss",
            kedge.make_sensor("gnss3", horizontal_std=POSITION_STD, vertical_std=POSITION_STD),
            rate=5.0,
        ),
        Installation(
            "velocity",
            kedge.make_sensor(
                "velocity3", horizontal_std=VELOCITY_STD, vertical_std=VELOCITY_STD
            ),
            rate=5.0,
        ),
    )
    rig = Rig(vehicle, sensors, kedge.Gaussian(mean, jnp.diag(std**2)))
    scenario = Scenario(rig, SECONDS, 1 / RATE, world=world)
    recording, _ = record(scenario, jax.random.key(0), output_rate=1e-3)
    return rig, recording


def test_one_log(log, times):
    rig, recording = log
    events = len(recording.stamps)
    call = compile_estimate(kedge.make_filter("extended"), rig, recording.log, keep=False)
    (found, _), ours = times.best(lambda: jax.block_until_ready(call()), 3)
    rival, theirs = times.best(lambda: plain(rig, recording), 2)
    _, packaged = times.best(lambda: gtsam_ekf(rig, recording), 2)
    last = np.asarray(found.moments.mean.position)[-1]
    np.testing.assert_allclose(last, rival.p, atol=2e-3)
    times.row("inertial, one log", "NumPy", theirs / events, ours / events)
    times.row("inertial, one log", "gtsam, 9 states", packaged / events, ours / events)
    rival, cheapest = times.best(lambda: inslib(rig, recording), 2)
    times.row("inertial, one log", "INSLIB", cheapest / events, ours / events)
    east, north, up = last
    # It turns with the earth, which the log does not: its gyroscopes' biases take that up.
    np.testing.assert_allclose(rival.position_local(), [north, east, -up], atol=0.2)


def test_live(log, times):
    rig, recording = log
    schedule = jax.tree.map(np.asarray, recording.log.schedule)
    controls = jax.tree.map(np.asarray, recording.log.controls)
    readings = jax.tree.map(np.asarray, recording.log.readings)
    count, names = 1000, rig.names

    def drive():
        live = kedge.Estimator(kedge.make_filter("extended"), rig, jax.random.key(0), lag=0.0)
        for event in range(count):
            time, sensor = float(schedule.time[event]), int(schedule.sensor[event])
            if sensor < 0:
                live.push(
                    time, control=jax.tree.map(lambda leaf, i=event + 1: leaf[i], controls)
                )
            else:
                row = int(schedule.row[event])
                value = jax.tree.map(lambda leaf, i=row: leaf[i], readings[sensor].measurement)
                live.push(time, sensor=names[sensor], measurement=value)
        return live.belief

    _, ours = times.best(drive, 3)
    _, theirs = times.best(lambda: plain(rig, recording, count), 2)
    times.row("inertial, live", "NumPy", theirs / count, ours / count)
    for name, rival in (("gtsam, 9 states", gtsam_ekf), ("INSLIB", inslib)):
        _, packaged = times.best(lambda rival=rival: rival(rig, recording, count), 2)
        times.row("inertial, live", name, packaged / count, ours / count)


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turn(v):
    """Rotation matrix of a rotation vector."""
    angle = np.sqrt(v @ v)
    if angle < 1e-9:
        return np.eye(3) + skew(v)
    K = skew(v / angle)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


class ErrorState:
    """A 15-state error-state filter in plain NumPy, as one would write it by hand.

    Local frame, errors in the body on the attitude: position, velocity, attitude, gyroscope
    bias, accelerometer bias. Analytic transition, Joseph's form, closed loop; ``R`` is
    map_from_body.
    """

    def __init__(self, p, v, R, cov, noise, walks, gravity=9.81):
        self.p, self.v, self.R, self.P = p.copy(), v.copy(), R.copy(), cov.copy()
        self.bg, self.ba = np.zeros(3), np.zeros(3)
        force, rate = noise
        bg_walk, ba_walk = walks
        self.gravity = np.array([0.0, 0.0, -gravity])
        self.Q = np.repeat([0.0, force**2, rate**2, bg_walk**2, ba_walk**2], 3)

    def predict(self, force, rate, dt):
        f, w = force - self.ba, rate - self.bg
        F = np.eye(15)
        F[0:3, 3:6] = np.eye(3) * dt
        F[3:6, 6:9] = -self.R @ skew(f) * dt
        F[0:3, 6:9] = F[3:6, 6:9] * (dt / 2)
        F[3:6, 12:15] = -self.R * dt
        F[0:3, 12:15] = -self.R * (dt**2 / 2)
        back = turn(-w * dt)
        F[6:9, 6:9] = back
        F[6:9, 9:12] = -np.eye(3) * dt
        push = f * dt + np.cross(w, f) * (dt**2 / 2)
        change = self.R @ push + self.gravity * dt
        self.p = self.p + (self.v + change / 2) * dt
        self.v = self.v + change
        self.R = self.R @ turn(w * dt)
        self.P = F @ self.P @ F.T
        self.P[range(15), range(15)] += self.Q * dt

    def update(self, H, residual, variance):
        S = H @ self.P @ H.T + np.diag(variance)
        K = np.linalg.solve(S, H @ self.P).T
        error = K @ residual
        IKH = np.eye(15) - K @ H
        self.P = IKH @ self.P @ IKH.T + (K * variance) @ K.T
        self.p, self.v = self.p + error[0:3], self.v + error[3:6]
        self.R = self.R @ turn(error[6:9])
        self.bg, self.ba = self.bg + error[9:12], self.ba + error[12:15]

    def position(self, fix, variance):
        H = np.zeros((3, 15))
        H[:, 0:3] = np.eye(3)
        self.update(H, fix - self.p, variance)

    def velocity(self, fix, variance):
        H = np.zeros((3, 15))
        H[:, 3:6] = np.eye(3)
        self.update(H, fix - self.v, variance)


def unpacked(recording):
    schedule = jax.tree.map(np.asarray, recording.log.schedule)
    told = recording.log.controls
    readings = [np.asarray(next(iter(own.measurement))) for own in recording.log.readings]
    steps = np.diff(schedule.time, prepend=0.0).tolist()
    return (
        zip(
            steps,
            schedule.sensor.tolist(),
            schedule.row.tolist(),
            np.asarray(told.specific_force),
            np.asarray(told.angular_rate),
            strict=True,
        ),
        readings,
    )


def start_of(rig):
    mean = jax.tree.map(np.asarray, rig.prior.mean)
    w, x, y, z = mean.attitude
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return mean, matrix


def plain(rig, recording, count=None):
    events, readings = unpacked(recording)
    mean, matrix = start_of(rig)
    own = ErrorState(
        mean.position,
        mean.velocity,
        matrix,
        np.asarray(rig.prior.cov),
        (FORCE_NOISE, RATE_NOISE),
        (RATE_WALK, FORCE_WALK),
    )
    variances = np.full(3, POSITION_STD**2), np.full(3, VELOCITY_STD**2)
    updates = own.position, own.velocity
    for number, (dt, sensor, row, force, rate) in enumerate(events):
        if number == count:
            break
        if dt > 0:
            own.predict(force, rate, dt)
        if sensor >= 0:
            updates[sensor](readings[sensor][row], variances[sensor])
    return own


def gtsam_ekf(rig, recording, count=None):
    import gtsam

    events, readings = unpacked(recording)
    mean, matrix = start_of(rig)
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    params.setAccelerometerCovariance(np.eye(3) * FORCE_NOISE**2)
    params.setGyroscopeCovariance(np.eye(3) * RATE_NOISE**2)
    params.setIntegrationCovariance(np.zeros((3, 3)))
    state = gtsam.NavState(gtsam.Rot3(matrix), mean.position, mean.velocity)
    # Its tangent vectors are attitude, position, velocity.
    order = [6, 7, 8, 0, 1, 2, 3, 4, 5]
    cov = np.asarray(rig.prior.cov)[np.ix_(order, order)]
    ekf = gtsam.NavStateImuEKF(state, cov, params)
    noise = np.eye(3) * POSITION_STD**2, np.eye(3) * VELOCITY_STD**2
    for number, (dt, sensor, row, force, rate) in enumerate(events):
        if number == count:
            break
        if dt > 0:
            ekf.predict(rate, force, dt)
        if sensor >= 0:
            here = ekf.state()
            turned = here.attitude().matrix()
            H = np.zeros((3, 9))
            H[:, 3 + 3 * sensor : 6 + 3 * sensor] = turned
            expected = here.position() if sensor == 0 else here.velocity()
            ekf.updateWithVector(expected, H, readings[sensor][row], noise[sensor])
    return ekf


LATITUDE = math.radians(49.32)  # where gravity is 9.81 m/s^2


def inslib(rig, recording, count=None):
    """INSLIB's 15 states, told all that the others are told, its detectors off."""
    INSLIB = pytest.importorskip("INSLIB")
    events, readings = unpacked(recording)
    mean, _ = start_of(rig)
    w, x, y, z = mean.attitude
    heading = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    east, north, up = mean.velocity
    std = np.sqrt(np.diag(np.asarray(rig.prior.cov)))[::3].tolist()
    radius, flattening = 6378137.0, 1 / 298.257223563
    bent = 1 - flattening * (2 - flattening) * math.sin(LATITUDE) ** 2
    by_north = radius * (1 - flattening) ** 2 / bent**1.5
    by_east = radius / bent**0.5 * math.cos(LATITUDE)
    p = mean.position

    def llh(place):
        return LATITUDE + place[1] / by_north, place[0] / by_east, float(place[2])

    latitude, longitude, height = llh(p)
    filter = INSLIB.Ins(
        INSLIB.Config(
            lat_rad=latitude,
            lon_rad=longitude,
            h_m=height,
            auto_init=False,
            rpy_init_rad=(0.0, 0.0, math.pi / 2 - heading),
            init_vel_ned=(north, east, -up),
            pos_init_stddev_m=std[0],
            vel_init_stddev_mps=std[1],
            rpy_init_stddev_rad=(std[2],) * 3,
            gyr_bias_init_stddev_rps=std[3],
            acc_bias_init_stddev_mps2=std[4],
            gyr_bias_pred_stddev_rps_sqrts=RATE_WALK,
            acc_bias_pred_stddev_mps2_sqrts=FORCE_WALK,
            kalman_update_dt_sec=1e-4,
            gnss_min_delay_ms=-1,
            gnss_init_dwell_disable=True,
            gnss_stop_disable=True,
            allow_unlimited_deadreckoning=True,
            auto_zupt_disable=True,
            chi2_disable=True,
        )
    )
    variances = (FORCE_NOISE**2 * RATE,) * 3, (RATE_NOISE**2 * RATE,) * 3
    fix, speed = (POSITION_STD**2,) * 3, (VELOCITY_STD**2,) * 3
    time, waiting = 0, False
    for number, (dt, sensor, row, force, rate) in enumerate(events):
        if number == count:
            break
        if dt > 0:
            if waiting:
                filter.update()
            time, waiting = time + round(dt * 1e6), True
            (fx, fy, fz), (wx, wy, wz) = force, rate
            filter.imu(time, dt, (fx, -fy, -fz), (wx, -wy, -wz), *variances)
        if sensor == 0:
            filter.gnss_pos_llh(llh(readings[0][row]), fix)
        elif sensor == 1:
            east, north, up = readings[1][row]
            filter.gnss_vel((north, east, -up), speed)
    filter.update()
    return filter
