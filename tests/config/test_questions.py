"""Logs whose numbers are possible but odd are asked about; those of every day are not."""

import numpy as np
import pytest

from kedge.config.questions import odd_angles, odd_clocks, odd_log, odd_ranges, odd_spans
from kedge.estimation.log import SECOND
from kedge.formats.logs import TargetMap
from kedge.formats.tables import table_of

ANCHORS = TargetMap(
    ("a", "b"), {"position_x": np.array([0.0, 3.0]), "position_y": np.array([0.0, 4.0])}
)


@pytest.mark.parametrize(("factor", "asked"), [(1.0, 0), (10.0, 0), (1000.0, 1)])
def test_ranges_far_beyond_the_map(factor, asked):
    found = list(odd_ranges("radio", factor * np.array([2.0, 4.0, np.nan, 6.0]), ANCHORS))
    assert len(found) == asked
    assert all("the map is 5 m wide; are they in mm" in text for text in found)


def test_one_anchor_has_no_width():
    lonely = TargetMap(("a",), {"position_x": np.array([3.0])})
    assert not list(odd_ranges("radio", np.array([1e6]), lonely))


@pytest.mark.parametrize(
    ("part", "values", "asked"),
    [
        ("heading", np.linspace(-np.pi, np.pi, 50), ""),
        ("heading", np.linspace(0, 359, 50), "heading goes up to 359 rad; is it in deg?"),
        ("yaw_rate", 0.5 * np.sin(np.arange(50)), ""),
        ("yaw_rate", 30 * np.sin(np.arange(50)), "is the yaw rate in deg/s?"),
        ("speed", np.linspace(0, 359, 50), ""),
    ],
)
def test_degrees_that_were_declared_radians(part, values, asked):
    found = list(odd_angles("wheels", {part: values}))
    assert [asked in text for text in found] == [True] * bool(asked)


@pytest.mark.parametrize(
    ("begin", "end", "asked"),
    [(0.0, 0.0, ""), (3.2, 3.2, "3.2 s after"), (-5.0, -5.1, "5 s before"), (20.0, 0.0, "")],
)
def test_a_clock_that_is_off_by_seconds(begin, end, asked):
    control = np.arange(0, 60 * SECOND, SECOND // 10)
    stamps = np.linspace(begin * SECOND, (59.9 + end) * SECOND, 600).astype(np.int64)
    found = list(odd_clocks(control, {"gnss": stamps}))
    assert [asked in text for text in found] == [True] * bool(asked)


@pytest.mark.parametrize(
    ("spans", "asked"),
    [
        ({"control": 60, "gnss": 59_900}, "gnss: lasts 5.99e+04 s, the others 60 s"),
        ({"control": 60, "gnss": 61, "truth": 0.06}, "truth: lasts 0.06 s, the others 60 s"),
        ({"control": 6e4, "gnss": 58, "imu": 60}, "control: lasts 6e+04 s"),
        ({"control": 60, "gnss": 20}, ""),
        ({"control": 6000, "gnss": 60}, ""),  # a hundredth: it was switched off
        ({"control": 60, "gnss": 0}, ""),
    ],
)
def test_a_source_of_another_unit_of_time(spans, asked):
    stamps = {
        name: np.linspace(0, span * SECOND, 50).astype(np.int64) for name, span in spans.items()
    }
    found = list(odd_spans(stamps))
    assert [asked in text for text in found] == [True] * bool(asked)


@pytest.mark.parametrize("place", [0.0, 2.0])
def test_a_truth_of_zeros_is_questioned(tmp_path, place):
    stamps, columns = np.arange(5) * SECOND, {"position_x": (np.zeros(5), "m")}
    columns["position_y"] = (np.full(5, place), "m")
    truth = table_of("truth", tmp_path, stamps, columns)
    found = list(odd_log(np.arange(5) * SECOND, {}, truth))
    assert ["all its positions are 0" in text for text in found] == [True] * (place == 0)
