"""Truth in a frame of its own is moved onto the track before it is compared."""

import numpy as np
import pytest

from kedge.core.errors import DataError
from kedge.estimation.log import Truth
from kedge.evaluation.score import Track, errors_of, in_the_map
from kedge.vehicles.constant_velocity import State

TIME = np.linspace(0, 10, 41)
PATH = np.stack([TIME, np.sin(TIME)], axis=1)
TRACK = Track(
    TIME, TIME, State(PATH, np.zeros_like(PATH)), np.broadcast_to(np.eye(4), (41, 4, 4))
)


def elsewhere(path):
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    return path @ turn.T + np.array([[30.0, -5.0]])


def test_the_same_shape_elsewhere_has_no_error():
    moved = in_the_map(Truth(TIME, {"position": elsewhere(PATH)}, True), TRACK)
    np.testing.assert_allclose(moved.fields["position"], PATH, atol=1e-12)
    assert not moved.own_frame
    np.testing.assert_allclose(errors_of(TRACK, moved).error, 0, atol=1e-12)


def test_another_shape_keeps_its_error():
    """A bump in the middle stays one; the mean of the error is moved away."""
    bump = PATH + np.exp(-((TIME - 5) ** 2))[:, None] * np.array([[0.0, 1.0]])
    error = errors_of(
        TRACK, in_the_map(Truth(TIME, {"position": elsewhere(bump)}, True), TRACK)
    )
    np.testing.assert_allclose(error.error.mean(axis=0), 0, atol=1e-12)
    assert 0.5 < np.abs(error.error).max() < 1.0


def test_truth_in_the_map_stays_and_one_without_positions_is_refused():
    known = Truth(TIME, {"position": PATH})
    assert in_the_map(known, TRACK) is known
    with pytest.raises(DataError, match="needs positions to be moved by"):
        in_the_map(Truth(TIME, {"heading": TIME}, True), TRACK)


def test_who_stood_is_scored_without_alignment():
    """Any rotation fits one place: a run is not lost for that."""
    spot = np.broadcast_to(np.array([[2.0, 3.0]]), PATH.shape)
    with pytest.warns(UserWarning, match="the errors are those without alignment"):
        known = in_the_map(Truth(TIME, {"position": spot}, True), TRACK)
    np.testing.assert_array_equal(known.fields["position"], spot)
    assert not known.own_frame
