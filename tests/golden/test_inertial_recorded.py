"""NaveGo's synthetic flight and EuRoC's IMU: what 15 states make of them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.config.filters import build_filter
from kedge.config.problem import load_problem
from kedge.core.manifolds import charts_of
from kedge.estimation.batch import estimate
from kedge.evaluation.score import errors_of, track_of
from kedge.evaluation.truth import truth_at


def passed(folder, name, overrides=None, until=None):
    if not (folder / name).is_dir():
        pytest.skip(f"KEDGE_DATA has no {name}")
    problem = load_problem(name, str(folder / name), until=until, overrides=overrides)
    found = estimate(build_filter("extended"), problem.rig, problem.recording.log)
    assert problem.truth is not None
    return problem, problem.truth, found


def angles(quaternions):
    """Yaw, pitch and roll of bodies forward-right-down over north-east-down."""
    matrices = Rotation.from_quat(np.roll(quaternions, -1, axis=1)).as_matrix()
    ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return Rotation.from_matrix(ned @ matrices @ np.diag([1.0, -1.0, -1.0])).as_euler("ZYX")


def test_navego(data):
    """After 60 s, beside the figures of an independent tool (pyins) on the same settings.

    At the last event of each time, so that what comes between fixes counts.
    """
    problem, truth, found = passed(data, "navego_synthetic")
    times = np.asarray(found.time)
    last = np.flatnonzero(np.append(np.diff(times) > 0, True))
    track = track_of(found, problem.recording._replace(outputs=last))
    errors = errors_of(track, truth)
    late = errors.time > 60
    rmse = dict(
        zip(errors.labels, np.sqrt(np.mean(errors.error[late] ** 2, axis=0)), strict=True)
    )
    assert rmse["position_y"] == pytest.approx(0.2294, rel=0.01)
    assert rmse["position_x"] == pytest.approx(0.3602, rel=0.01)
    assert rmse["position_z"] == pytest.approx(0.5133, rel=0.01)
    assert rmse["velocity_y"] == pytest.approx(0.0219, rel=0.01)
    assert rmse["velocity_x"] == pytest.approx(0.0206, rel=0.01)
    assert rmse["velocity_z"] == pytest.approx(0.0116, rel=0.01)

    true, _ = truth_at(truth, track.time, charts_of(type(track.mean)))
    gap = angles(true["attitude"]) - angles(np.array(track.mean.attitude))
    gap = np.degrees((gap + np.pi) % (2 * np.pi) - np.pi)
    yaw, pitch, roll = np.sqrt(np.mean(gap[late] ** 2, axis=0))
    assert roll == pytest.approx(0.0664, rel=0.03)
    assert pitch == pytest.approx(0.0648, rel=0.03)
    assert yaw == pytest.approx(0.4166, rel=0.05)

    sensor, nis = np.asarray(problem.recording.log.schedule.sensor), found.outcome.nis
    assert 5.8 < sum(np.mean(np.asarray(nis)[sensor == number]) for number in (0, 1)) < 6.2


def test_euroc_runs_away_from_its_true_start_as_its_biases_say(data):
    """Raw 10 m and more after 5 s; with the biases that its truth shows, decimetres."""
    known = {
        "prior.mean": "{ gyroscope_bias = [-0.0031, 0.0211, 0.0787], "
        "accelerometer_bias = [-0.02, 0.14, 0.07] }"
    }
    drift = []
    for overrides in (None, known):
        problem, truth, found = passed(data, "euroc_mh01_imu", overrides, until=5.0)
        track = track_of(found, problem.recording)
        errors = errors_of(track, truth)
        drift.append(float(np.linalg.norm(errors.error[-1, :3])))
    assert 8.0 < drift[0] < 20.0
    assert drift[1] < 0.6
