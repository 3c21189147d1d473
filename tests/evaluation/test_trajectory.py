"""Oracles: closed forms of simple motions, defining equations, invariances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kedge.core.errors import ConfigError, DataError, UnknownName
from kedge.evaluation.trajectory import (
    Motion,
    Trajectory,
    absolute_pose_error,
    align,
    associate,
    relative_pose_error,
    umeyama,
)

seeds = st.integers(0, 2**32 - 1)
sizes = st.sampled_from([2, 3])


def random_walk(seed, size, count=40):
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.normal(size=(count, 3))).as_quat()[:, [3, 0, 1, 2]]
    turns = turns if size == 3 else rng.uniform(-np.pi, np.pi, count)
    steps = rng.normal(size=(count, size))
    return Trajectory(np.cumsum(rng.uniform(0.1, 1, count)), np.cumsum(steps, axis=0), turns)


def random_motion(seed, size, scale=1.0):
    rng = np.random.default_rng([seed, 1])
    turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    return Motion(turn, rng.normal(size=size) * 10, scale)


def noisy(trajectory, seed, position=0.3, angle=0.1):
    rng = np.random.default_rng([seed, 2])
    count = trajectory.time.size
    moved = trajectory.position + rng.normal(size=trajectory.position.shape) * position
    if trajectory.orientation.ndim == 1:
        turned = trajectory.orientation + rng.normal(size=count) * angle
    else:
        turns = Rotation.from_quat(trajectory.orientation[:, [1, 2, 3, 0]])
        turns = turns * Rotation.from_rotvec(rng.normal(size=(count, 3)) * angle)
        turned = turns.as_quat()[:, [3, 0, 1, 2]]
    return Trajectory(trajectory.time, moved, turned)


def straight(count=21, spacing=0.5, period=1.0):
    """Along x at constant speed, heading ahead."""
    distance = spacing * np.arange(count)
    position = np.stack([distance, np.zeros(count)], axis=1)
    return Trajectory(period * np.arange(count), position, np.zeros(count))


def angle_between(a, b):
    """Angle in rad between orientations; of quaternions by their chord in the sphere S3."""
    if a.ndim == 1:
        return np.abs(np.angle(np.exp(1j * (a - b))))
    chord = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return 4 * np.arcsin(chord / 2)


# Trajectory


@pytest.mark.parametrize(
    ("time", "position", "orientation", "message"),
    [
        ([0, 1], [[0, 0], [np.nan, 0]], None, "not finite"),
        ([0, 1], [[0, 0, 0, 0]] * 2, None, "position"),
        ([0, 1], [[0, 0]] * 2, [[1, 0, 0, 0]] * 2, "orientation"),
        ([0, 1], [[0, 0, 0]] * 2, [0, 0], "orientation"),
        ([0, 1], [[0, 0, 0]] * 2, [[1, 0, 0, 1]] * 2, "unit length"),
        ([0, 2, 1], [[0, 0]] * 3, None, "backwards after 2.0"),
    ],
)
def test_what_is_no_trajectory_is_refused(time, position, orientation, message):
    turns = None if orientation is None else np.array(orientation, dtype=float)
    with pytest.raises(DataError, match=message):
        Trajectory(np.array(time, dtype=float), np.array(position, dtype=float), turns)


def test_to_plane_keeps_the_heading_whatever_pitch_and_roll():
    heading = np.array([0.3, -3.0, 2.0])
    turns = Rotation.from_euler(
        "ZYX", np.stack([heading, [0.5, -1.0, 0], [2, 0, -0.4]], axis=1)
    )
    position = np.arange(9.0).reshape(3, 3)
    spatial = Trajectory(np.arange(3.0), position, turns.as_quat()[:, [3, 0, 1, 2]])
    np.testing.assert_allclose(spatial.to_plane().orientation, heading, atol=1e-12)
    np.testing.assert_array_equal(spatial.to_plane().position, position[:, :2])


# Association


@given(seed=seeds)
def test_association_is_exact_on_straight_lines_and_steady_turns(seed):
    rng = np.random.default_rng(seed)
    axis, rate = rng.normal(size=3), rng.normal(size=3)
    start = Rotation.from_rotvec(rng.normal(size=3))

    def motion(time):
        turns = start * Rotation.from_rotvec(time[:, None] * axis)
        return Trajectory(time, time[:, None] * rate, turns.as_quat()[:, [3, 0, 1, 2]])

    truth = motion(np.cumsum(rng.uniform(0.05, 0.3, 50)))
    stamps = np.sort(rng.uniform(truth.time[0], truth.time[-1], 30))
    estimate = random_walk(seed, 3, 30)
    estimate = Trajectory(stamps, estimate.position, estimate.orientation)

    kept, found = associate(estimate, truth, max_gap=1.0)

    np.testing.assert_array_equal(kept.position, estimate.position)
    np.testing.assert_array_equal(found.time, stamps)
    np.testing.assert_allclose(found.position, motion(stamps).position, atol=1e-12)
    assert np.max(angle_between(found.orientation, motion(stamps).orientation)) < 1e-7


def test_heading_takes_the_shortest_arc():
    truth = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 2)), np.array([3.0, -3.0]))
    estimate = Trajectory(np.array([0.25, 0.5]), np.zeros((2, 2)), np.zeros(2))
    _, found = associate(estimate, truth, max_gap=1.0)
    arc = 2 * np.pi - 6
    expected = np.array([3 + arc / 4, 3 + arc / 2])
    assert np.max(angle_between(found.orientation, expected)) < 1e-12


def test_stamps_that_truth_does_not_cover_are_left_out():
    time = np.array([1.0, 2.0, 3.0, 6.0, 7.0])
    truth = Trajectory(time, np.stack([time, 2 * time], axis=1))
    stamps = np.array([0.9, 1.0, 1.5, 3.0, 3.1, 5.9, 6.0, 6.5, 7.0, 7.1])
    estimate = Trajectory(stamps, np.zeros((10, 2)), stamps / 10)

    kept, found = associate(estimate, truth, max_gap=2.0)
    np.testing.assert_array_equal(kept.time, [1.0, 1.5, 3.0, 6.0, 6.5, 7.0])
    np.testing.assert_allclose(found.position[:, 1], 2 * kept.time)
    np.testing.assert_array_equal(kept.orientation, kept.time / 10)
    assert found.orientation is None

    assert associate(estimate, truth, max_gap=3.0)[0].time.size == 8


def test_a_gap_of_just_max_gap_is_covered_however_its_stamps_round():
    time = 0.1 * np.arange(50)
    truth = Trajectory(time, np.zeros((50, 2)))
    between = Trajectory(time[:-1] + 0.05, np.zeros((49, 2)))
    assert associate(between, truth, max_gap=0.1)[0].time.size == 49


def test_association_refuses_what_cannot_match():
    line = straight()
    spatial = Trajectory(line.time, np.zeros((21, 3)))
    with pytest.raises(DataError, match="covers no estimate"):
        associate(Trajectory(line.time + 100, line.position), line, 1.0)
    with pytest.raises(DataError, match="to_plane"):
        associate(spatial, line, 1.0)
    with pytest.raises(DataError, match="same time"):
        associate(line, Trajectory(0 * line.time, line.position), 1.0)


# Alignment


@given(seed=seeds, size=sizes, scale=st.sampled_from([1.0, 0.3, 4.0]))
def test_alignment_recovers_the_motion(seed, size, scale):
    truth = random_walk(seed, size)
    motion = random_motion(seed, size, scale)
    back = Motion(motion.rotation.T, -motion.rotation.T @ motion.translation / scale, 1 / scale)
    estimate = back.apply(truth)
    kind = "rigid" if scale == 1 else "similarity"

    found = umeyama(estimate.position, truth.position, scaled=kind == "similarity")
    np.testing.assert_allclose(found.rotation, motion.rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, motion.translation, atol=1e-10)
    np.testing.assert_allclose(found.scale, scale, rtol=1e-12)

    error = absolute_pose_error(align(estimate, truth, kind), truth)
    assert error.translation.max < 1e-10
    assert error.rotation.max < 1e-10


@given(seed=seeds)
def test_planar_rotation_is_the_angle_of_the_summed_complex_products(seed):
    # In the complex plane the best rotation is the phase of sum conj(x) y: no matrix needed.
    truth = random_walk(seed, 2)
    estimate = noisy(random_motion(seed, 2).apply(truth), seed)
    x, y = (t.position @ [1, 1j] for t in (estimate, truth))
    x, y = x - x.mean(), y - y.mean()
    phase = np.angle(np.sum(x.conj() * y))
    scale = np.abs(np.sum(x.conj() * y)) / np.sum(np.abs(x) ** 2)
    found = umeyama(estimate.position, truth.position, scaled=True)
    np.testing.assert_allclose(found.rotation @ [1, 0], [np.cos(phase), np.sin(phase)])
    np.testing.assert_allclose(found.scale, scale)


@given(seed=seeds, size=sizes, scaled=st.booleans(), mirrored=st.booleans())
def test_no_other_motion_fits_better(seed, size, scaled, mirrored):
    truth = random_walk(seed, size, 12)
    estimate = noisy(truth, seed)
    source = estimate.position * np.where(mirrored, [-1] + [1] * (size - 1), 1)
    found = umeyama(source, truth.position, scaled)
    np.testing.assert_allclose(np.linalg.det(found.rotation), 1.0)

    def cost(motion):
        moved = motion.scale * source @ motion.rotation.T + motion.translation
        return np.sum((moved - truth.position) ** 2)

    for other in range(20):
        nudge = random_motion([seed, other], size)
        # A small turn by the exponential of a skew matrix, or a wholly different one.
        skew = nudge.rotation - nudge.rotation.T
        near = np.linalg.solve(np.eye(size) + 1e-3 * skew, np.eye(size) - 1e-3 * skew)
        for turn in (near @ found.rotation, nudge.rotation):
            scale = found.scale * (1 + 1e-3 * (other - 10) if scaled else 1)
            shift = truth.position.mean(0) - scale * turn @ source.mean(0)
            assert cost(Motion(turn, shift, scale)) >= cost(found) * (1 - 1e-12)


def test_origin_lays_the_first_pose_on_truth():
    truth = random_walk(1, 3)
    moved = random_motion(1, 3).apply(truth)
    error = absolute_pose_error(align(moved, truth, "origin"), truth)
    assert error.translation.max < 1e-10
    assert error.rotation.max < 1e-10

    shifted = Trajectory(truth.time, truth.position + np.array([[1.0, 2.0, 3.0]]))
    found = align(shifted, truth, "origin")
    np.testing.assert_allclose(found.position, truth.position)
    assert found.orientation is None


def test_alignment_refuses_what_it_cannot_determine():
    spot = 1e6 / 3 + 1e-10 * np.random.default_rng(0).normal(size=(9, 2))  # rounding only
    line = np.arange(9.0)[:, None] / 3
    with pytest.raises(DataError, match="one spot"):
        umeyama(spot, spot, scaled=False)
    with pytest.raises(DataError, match="one line"):
        umeyama(line * [[1.1, 2.3, 3.7]], line * [[0.7, 0.1, 0.3]], scaled=False)
    # In the plane a line is enough.
    umeyama(line * [[1.0, 2.0]], line * [[1.0, 0.0]], scaled=False)
    with pytest.raises(UnknownName, match="origin, rigid"):
        align(straight(), straight(), "icp")
    with pytest.raises(DataError, match="associate"):
        align(straight(), straight(period=2.0), "none")


# Absolute pose error


def test_absolute_errors_are_distances_and_angles():
    truth = Trajectory(np.arange(4.0), np.zeros((4, 2)), np.array([0.0, 3.1, -3.1, 1.0]))
    estimate = Trajectory(
        np.arange(4.0),
        np.array([[3.0, 4.0], [0.0, 1.0], [2.0, 0.0], [0.0, 0.0]]),
        np.array([0.5, -3.1, 3.1, 1.0 + 4 * np.pi]),
    )
    error = absolute_pose_error(estimate, truth)
    across = 2 * np.pi - 6.2
    np.testing.assert_array_equal(error.time, np.arange(4.0))
    np.testing.assert_allclose(error.translations, [5, 1, 2, 0])
    np.testing.assert_allclose(error.rotations, [0.5, across, across, 0], atol=1e-12)
    # 5, 1, 2, 0: squares sum to 30, deviations from the mean of 2 square to 9 + 1 + 0 + 4.
    expected = (7.5**0.5, 2.0, 1.5, 3.5**0.5, 0.0, 5.0)
    np.testing.assert_allclose(error.translation, expected)
    assert error.translation._fields == ("rmse", "mean", "median", "std", "min", "max")


@given(seed=seeds, size=sizes)
def test_absolute_error_is_the_same_in_any_map_frame(seed, size):
    truth, motion = random_walk(seed, size), random_motion(seed, size)
    estimate = noisy(truth, seed)
    here = absolute_pose_error(estimate, truth)
    there = absolute_pose_error(motion.apply(estimate), motion.apply(truth))
    np.testing.assert_allclose(there.translations, here.translations, atol=1e-10)
    np.testing.assert_allclose(there.rotations, here.rotations, atol=1e-10)
    np.testing.assert_allclose(
        here.rotations, angle_between(estimate.orientation, truth.orientation), atol=1e-6
    )


def test_without_orientation_there_is_no_rotation_error():
    bare = Trajectory(straight().time, straight().position)
    for error in (
        absolute_pose_error(bare, straight()),
        relative_pose_error(straight(), bare, 1),
    ):
        assert error.rotations is None
        assert error.rotation is None
        assert error.translation.max == 0


# Relative pose error


@given(seed=seeds, size=sizes, delta=st.integers(1, 20))
def test_relative_error_ignores_where_the_estimate_started(seed, size, delta):
    truth, motion = random_walk(seed, size), random_motion(seed, size)
    same = relative_pose_error(motion.apply(truth), truth, delta)
    assert same.translation.max < 1e-9
    assert same.rotation.max < 1e-9

    estimate = noisy(truth, seed)
    here = relative_pose_error(estimate, truth, delta)
    there = relative_pose_error(motion.apply(estimate), truth, delta)
    assert here.translation.max > 1e-3
    np.testing.assert_allclose(there.translations, here.translations, atol=1e-9)
    np.testing.assert_allclose(there.rotations, here.rotations, atol=1e-9)


@pytest.mark.parametrize(
    ("delta", "unit", "ends"),
    [
        (1, "frames", range(1, 21)),
        (6, "frames", [6, 12, 18]),
        (2.0, "metres", [4, 8, 12, 16, 20]),
        (1.2, "metres", [3, 6, 9, 12, 15, 18]),  # the excess is not carried over
        (0.2, "seconds", [2, 4, 6, 8, 10, 12, 14, 16, 18, 20]),
    ],
)
def test_a_scale_error_of_one_percent_shows_as_such(delta, unit, ends):
    truth = straight(spacing=0.5, period=0.1)
    estimate = Trajectory(truth.time, truth.position * 1.01, truth.orientation)
    error = relative_pose_error(estimate, truth, delta, unit, pairs_from="truth")
    ends = np.array(ends)
    np.testing.assert_array_equal(error.time, truth.time[ends])
    np.testing.assert_allclose(error.translations, 0.01 * 0.5 * ends[0])
    assert error.rotation.max == 0


def test_a_heading_drift_bends_the_motion_as_seen_from_the_body():
    # A body that turns by 0.01 rad a frame more than it should, and is moved truly in the map:
    # over one step the angle is 0.01, and seen from its k-th pose the step lies k * 0.01 off.
    truth = straight()
    drift = 0.01 * np.arange(21)
    error = relative_pose_error(Trajectory(truth.time, truth.position, drift), truth, 1)
    np.testing.assert_allclose(error.rotations, 0.01)
    chords = 2 * 0.5 * np.sin(drift[:-1] / 2)
    np.testing.assert_allclose(error.translations, chords, atol=1e-15)


def test_paths_differ_so_pairs_may():
    truth = straight()
    estimate = Trajectory(truth.time, truth.position * 2, truth.orientation)
    own = relative_pose_error(estimate, truth, 2.0, "metres")
    shared = relative_pose_error(estimate, truth, 2.0, "metres", pairs_from="truth")
    assert own.time.size == 10
    assert shared.time.size == 5


def test_without_orientation_displacements_are_compared_in_the_map():
    truth, drift = straight(), np.array([[0.0, 0.02]]) * np.arange(21)[:, None]
    estimate = Trajectory(truth.time, truth.position + drift)
    error = relative_pose_error(estimate, truth, 5)
    np.testing.assert_allclose(error.translations, 0.1)


def test_relative_error_refuses_what_it_cannot_do():
    line = straight()
    with pytest.raises(DataError, match="apart"):
        relative_pose_error(line, line, 100.0, "metres")
    with pytest.raises(UnknownName, match="frames, metres, seconds"):
        relative_pose_error(line, line, 1, "radians")
    with pytest.raises(UnknownName, match="estimate, truth"):
        relative_pose_error(line, line, 1, pairs_from="both")
    for delta in (0, -1, 1.5, float("nan")):
        with pytest.raises(ConfigError, match="whole"):
            relative_pose_error(line, line, delta)
