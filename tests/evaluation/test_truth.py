"""A sparse truth is compared with at its own stamps, a dense one at the outputs."""

from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.batch import Estimates
from kedge.estimation.log import SECOND, Stamped, Truth, assemble
from kedge.evaluation.score import at_truth, errors_of, track_of
from kedge.evaluation.truth import judged_at
from kedge.vehicles.constant_velocity import State

START = 1_700_000_000 * SECOND
NOTHING = np.zeros(0, np.int64)


def circle(time):
    """A turn every 8 s, a metre away from the middle."""
    angle = np.asarray(time) * np.pi / 4
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def truth(period, phase=0.123_456_789):
    time = np.arange(0.0, 30.0, period) + phase
    return Truth(time, {"position": circle(time)})


@pytest.mark.parametrize(
    ("period", "rate", "sparse"),
    [
        (1.0, 10.0, True),
        (0.97, 10.0, True),
        (0.5, 10.0, False),
        (1.0, 0.5, False),
        (4.0, 0.5, True),
    ],
)
def test_which_truth_is_sparse(period, rate, sparse):
    assert (judged_at(truth(period), START, START + 30 * SECOND, rate) is not None) == sparse


def test_an_estimate_without_error_has_none_at_the_stamps_of_a_sparse_truth():
    """Between the samples, 2 s apart, the chord is 1 - cos(45 deg) = 0.29 m off the circle."""
    known, end = truth(2.0), START + 20 * SECOND
    judged = judged_at(known, START, end, 10.0)
    assert judged is not None
    assert judged.tolist() == [START + n * 2 * SECOND + 123_456_789 for n in range(10)]
    sources: list[Stamped] = []
    recording = assemble(START, end, NOTHING, (), sources, 10.0, judged)
    assert len(recording.outputs) == 200  # as without it
    time = np.asarray(recording.log.schedule.time)
    position = circle(time)
    cov = np.broadcast_to(np.eye(4), (len(time), 4, 4))
    mean = State(jnp.asarray(position), jnp.zeros_like(position))
    moments, silent = Gaussian(mean, jnp.asarray(cov)), cast(Any, None)
    estimates = Estimates(jnp.asarray(time), moments, silent)

    track = at_truth(estimates, recording)
    errors = errors_of(track, known).error
    assert errors.shape == (10, 2)
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)
    between = errors_of(track_of(estimates, recording), known).error
    assert np.nanmax(np.linalg.norm(between, axis=1)) == pytest.approx(1 - 0.5**0.5, abs=0.01)
