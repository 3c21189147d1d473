"""The Snapir's dead reckoning: calibrated on other runs it must beat what comes as it is."""

import sys
from pathlib import Path

import numpy as np

EXAMPLES = str(Path(__file__).parents[2] / "examples")


def test_calibration_on_other_runs_takes_half_of_the_error(data, monkeypatch):
    """Medians over three runs, of the distance covered."""
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.delitem(sys.modules, "auv_dead_reckoning", raising=False)
    import auv_dead_reckoning as example

    logs = [f"{data}/auv_akit_snapir#{run}" for run in (2, 3, 7)]
    own = [example.calibration(log) for log in logs]
    np.testing.assert_allclose([c.arm[0] for c in own], -1.83, atol=0.05)
    others = [example.typical(own[:n] + own[n + 1 :]) for n in range(len(logs))]
    raw, calibrated, inside = [], [], {}
    for name, rig, found, shares in (
        ("raw", "auv_akit_snapir-plain", [None] * len(logs), raw),
        ("calibrated", "auv_akit_snapir", others, calibrated),
    ):
        runs = [run.scores for run, _ in example.reckoned(rig, logs, found)]
        shares += [scores.final_error_of_distance for scores in runs]
        inside[name] = [scores.coverage_95["position"] for scores in runs]

    assert 0.0025 < np.median(raw) < 0.004
    assert np.median(calibrated) < 0.003
    assert np.median(calibrated) < 0.75 * np.median(raw)
    # A calibration that is a state knows what it is worth; the reference wanders all the same.
    assert np.median(inside["calibrated"]) > 0.7 > 0.5 > np.median(inside["raw"])
