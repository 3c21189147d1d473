"""Errors against truth: where it is known, which way round, and in which chart."""

import numpy as np
import pytest

from kedge.core.manifolds import charts_of
from kedge.estimation.log import Truth
from kedge.evaluation.score import Track, errors_of
from kedge.evaluation.truth import truth_at
from kedge.vehicles.unicycle import State

CHARTS = dict(charts_of(State))


def line(time):
    """A truth that drives along x with 2 m/s; its heading passes half a turn."""
    heading = np.mod(3.0 + 0.1 * time + np.pi, 2 * np.pi) - np.pi
    return Truth(time, {"heading": heading, "position": np.stack([2 * time, 0 * time], 1)})


def test_truth_is_known_between_its_samples_alone():
    truth = line(np.array([0.0, 1.0, 2.0, 9.0, 10.0]))
    time = np.array([-0.1, 0.0, 0.4, 2.0, 5.0, 9.0, 10.0, 10.1])
    fields, covered = truth_at(truth, time, CHARTS, max_gap=1.0)
    assert covered.tolist() == [False, True, True, True, False, True, True, False]
    np.testing.assert_allclose(fields["position"][covered, 0], 2 * time[covered])


@pytest.mark.parametrize("period", [0.3, 0.5, 4.0])
def test_evenly_sampled_truth_is_known_however_seldom_it_comes(period):
    time = np.arange(0.0, 30.0, period)
    middle = (time[1:] + time[:-1]) / 2
    assert truth_at(line(time), middle, CHARTS)[1].all()


def test_a_gap_of_two_periods_is_not_bridged():
    time = np.delete(np.arange(0.0, 12.0), 5)
    middle = np.array([3.5, 4.5, 5.5, 6.5])
    assert truth_at(line(time), middle, CHARTS)[1].tolist() == [True, False, False, True]


def test_errors_are_truth_minus_estimate_in_the_chart_of_each_field():
    time = np.arange(0.0, 6.0, 0.25)
    cov = np.arange(9.0).reshape(3, 3) + 10 * np.eye(3)
    mean = State(
        np.stack([2 * time - 0.5, 0 * time + 0.2], 1),
        np.mod(3.0 + 0.1 * time - 0.3 + np.pi, 2 * np.pi) - np.pi,
    )
    track = Track(time, None, mean, np.broadcast_to(cov, (len(time), 3, 3)))
    errors = errors_of(track, line(np.arange(0.0, 5.01, 0.5)))
    known = time <= 5.0
    assert np.isnan(errors.error[~known]).all()
    for field, offset in (("position", [0.5, -0.2]), ("heading", [0.3])):
        of_field = errors.error[known][:, errors.fields[field]]
        np.testing.assert_allclose(of_field, np.broadcast_to(offset, of_field.shape), atol=1e-9)
    # The covariance is permuted as the errors are, whatever the order of truth's fields.
    places = [("position_x", 0), ("position_y", 1), ("heading", 2)]
    picked = [dict(places)[label] for label in errors.labels]
    np.testing.assert_array_equal(errors.cov[0], cov[np.ix_(picked, picked)])
