"""A truth that was somewhere else for a moment: found where it was put, and nowhere else."""

import numpy as np
import pytest

from kedge.estimation.log import Truth
from kedge.evaluation.glitches import glitches, without_glitches

TIME = np.arange(0.0, 60.0, 0.02)


def drive():
    """A loop at .6 m/s with a stop of ten seconds, seen to half a millimetre."""
    along = np.interp(TIME, [0, 20, 30, 60], [0, 12, 12, 30])
    path = np.stack([5 * np.cos(along / 5), 5 * np.sin(along / 5)], axis=1)
    return path + 0.0005 * np.random.default_rng(0).normal(size=path.shape)


def test_a_good_truth_has_none():
    assert not glitches(TIME, drive()).any()


@pytest.mark.parametrize(("first", "count"), [(500, 1), (700, 40), (1250, 99), (2900, 5)])
def test_what_jumps_away_and_back_is_found_to_the_sample(first, count):
    path = drive()
    path[first : first + count] += [0.4, -0.3]
    expected = np.zeros(len(path), bool)
    expected[first : first + count] = True
    np.testing.assert_array_equal(glitches(TIME, path), expected)
    kept, wrong = without_glitches(Truth(TIME, {"position": path}))
    assert (wrong, len(kept.time)) == (count, len(TIME) - count)


def test_several_and_one_that_hops_about():
    path, wrong = drive(), np.zeros(len(TIME), bool)
    for first, away in ((300, 3.0), (302, -2.0), (1000, 0.5), (2000, 7.0)):
        path[first : first + 2] += away
        wrong[first : first + 2] = True
    np.testing.assert_array_equal(glitches(TIME, path), wrong)


def test_who_jumps_and_stays_is_believed():
    """From then on nobody knows which side is the truth."""
    path = drive()
    path[1500:] += 2.0
    assert not glitches(TIME, path).any()
