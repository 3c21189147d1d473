"""One lap of paper B's robot is enough to tune it as well as was done by hand."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "tune_omni.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("tune_omni", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_one_lap_tunes_as_well_as_a_hand(example):
    """The square; the example does the circle too."""
    tuned, scores = example.compare("omni-square", seed=0, runs=40)
    hand, guess, innovations, truth = scores
    for found in (innovations, truth):
        position, heading, nees, nis = found
        assert position < 1.03 * hand[0]
        assert heading < 1.03 * hand[1]
        assert position < 0.9 * guess[0]
        assert 2.0 < nees < 4.5
        assert 2.5 < nis < 3.5
    assert guess[2] < 0.5
    # What the camera scatters by is known well.
    by_readings = tuned["innovations"]
    rows = dict(
        zip(
            (t.key.split(".")[-1] for t in by_readings.chosen),
            zip(by_readings.values, by_readings.judgements, strict=True),
            strict=True,
        )
    )
    for key, true in (("offset_std", 0.05), ("orientation_std", 0.03)):
        value, judgement = rows[key]
        assert judgement.identified
        assert value == pytest.approx(true, rel=0.15)
    # On flat ground wheels and slip push the robot alike.
    pushes = ("wheel_noise", "slip_noise", "turn_noise")
    assert not all(rows[key][1].identified for key in pushes)
