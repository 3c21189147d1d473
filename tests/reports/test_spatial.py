"""Figures and scores of what moves in space, on tracks whose errors are known."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.core.quantities import Attitude, Position3
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Truth
from kedge.evaluation import score
from kedge.evaluation.score import Run, Track, errors_of
from kedge.evaluation.scores import FilterScores, HealthScores
from kedge.evaluation.truth import longest_gap
from kedge.reports import spatial

pytest.importorskip("matplotlib")

TIME = np.arange(0, 100.0)
SPEED, ERROR, TURN = 2.0, np.array([0.3, -0.4, 1.2]), 0.05


class State(NamedTuple):
    position: Position3
    attitude: Attitude


def run(name="extended"):
    """A straight line: truth once a second, and an estimate beside it, turned to the left."""
    true = np.stack([SPEED * TIME, 0 * TIME, -5 + np.sin(TIME / 20)], axis=1)
    level = np.tile([1.0, 0, 0, 0], (len(TIME), 1))
    truth = Truth(TIME, {"position": true, "attitude": level})
    turned = Rotation.from_euler("z", np.full(len(TIME), -TURN)[:, None])
    mean = State(true - ERROR[None], turned.as_quat()[:, [3, 0, 1, 2]])
    track = Track(TIME, None, mean, np.tile(0.01 * np.eye(6), (len(TIME), 1, 1)))
    outcome = SimpleNamespace(verdict=np.full(len(TIME), Verdict.FUSED))
    errors = errors_of(track, truth)
    blank = FilterScores(sensors={}, health=HealthScores(0, 0), std={}, singular=0.0)
    others = score._spatial_errors(track, truth, errors)
    scores = score._with_path(score._with_errors(blank, errors, others), track, truth)
    return Run(name, SimpleNamespace(time=TIME, outcome=outcome), track, errors, scores), truth


def test_scores_in_plan_of_heading_and_by_distance():
    found = run()[0].scores
    np.testing.assert_allclose(found.rmse["horizontal"].value, 0.5)
    np.testing.assert_allclose(found.rmse["position"].value, 1.3)
    np.testing.assert_allclose(found.rmse["position_z"].value, 1.2)
    np.testing.assert_allclose(found.rmse["heading"].value, TURN)
    assert found.rpe["10_m"].rmse > 0  # the motion is turned by the wrong heading
    share = 1.3 / (SPEED * TIME[-1])
    np.testing.assert_allclose(found.final_error_of_distance, share, rtol=1e-3)


def test_truth_that_comes_rarely_is_truth_all_the_same():
    assert longest_gap(np.arange(0, 9.0)) == 1.5
    assert longest_gap(np.arange(0, 1, 0.01)) == 0.5


def test_height_keeps_to_truth_and_cuts_off_what_strays():
    main, truth = run()
    deep = main.track.mean._replace(position=main.track.mean.position - 1e3)
    stray = main._replace(name="dead-reckoning", track=main.track._replace(mean=deep))

    ax = spatial.plot_heights([stray, main], main, truth)

    assert spatial.is_spatial(main)
    low, high = ax.get_ylim()
    assert -9 < low < -6.2
    assert -4 < high < 0
    assert {"truth", "± 3σ", "extended"} <= set(ax.get_legend_handles_labels()[1])
    assert ax.get_ylabel() == "height, z (m)"


def test_attitude_is_drawn_by_angle():
    axes = spatial.plot_attitude(*run())
    assert [ax.get_ylabel().split(",")[0] for ax in axes[1:]] == ["pitch", "roll"]
    truth, estimate = (line.get_ydata() for line in axes[0].lines[:2])
    np.testing.assert_allclose(truth, 0, atol=1e-9)
    np.testing.assert_allclose(estimate, -np.degrees(TURN))


def test_drift_is_in_per_cent_of_the_distance():
    main, truth = run()
    ax = spatial.plot_drift([main], truth)
    distance, share = ax.lines[0].get_data()
    np.testing.assert_allclose(share * distance / 100, 1.3, rtol=1e-9)
    assert "%" in ax.get_ylabel()
