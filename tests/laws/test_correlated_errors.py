"""Told of an error with a memory, filter and smoother are as sure as they may be (law 14).

The truth's error lasts for 0.5 to 30 s. Runs are independent, so that the NEES of all runs at
one time is chi-square; the bounds hold 99.9 % of such tests.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy

from kedge.estimation.correlated_error import CorrelatedError

RUNS, SECONDS = 200, 60.0


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "examples"))
    monkeypatch.delitem(sys.modules, "correlated_errors", raising=False)
    import correlated_errors

    return correlated_errors


@pytest.mark.parametrize("treatment", ["estimated", "considered"])
@pytest.mark.parametrize(
    "tau", [3.0, *(pytest.param(tau, marks=pytest.mark.slow) for tau in (0.5, 10.0, 30.0))]
)
def test_who_is_told_of_the_error_is_honest(example, tau, treatment):
    truth = example.rig_of(CorrelatedError(example.LASTING, tau))
    error = CorrelatedError(example.LASTING, tau, treatment=treatment)
    bounds = scipy.stats.chi2(2 * RUNS).ppf([0.0005, 0.9995]) / (2 * RUNS)
    for one in example.figures(truth, example.rig_of(error), RUNS, SECONDS):
        assert 0.93 <= one.coverage <= 0.97
        at_the_end = one.nees[:, -1].mean()
        assert bounds[0] <= at_the_end <= bounds[1]


@pytest.mark.parametrize("tau", [3.0, pytest.param(30.0, marks=pytest.mark.slow)])
def test_who_takes_it_for_white_is_not(example, tau):
    truth = example.rig_of(CorrelatedError(example.LASTING, tau))
    told = example.rig_of(None, float(np.hypot(example.WHITE, example.LASTING)))
    for one in example.figures(truth, told, RUNS, SECONDS):
        assert one.coverage < 0.9
        assert one.nees.mean() > 1.3


def test_widened_readings_are_not_too_sure(example):
    truth = example.rig_of(CorrelatedError(example.LASTING, 10.0))
    error = CorrelatedError(example.LASTING, 10.0, treatment="widened")
    for one in example.figures(truth, example.rig_of(error), RUNS, SECONDS):
        assert one.coverage >= 0.93
