"""Tapers: the values that the defining convolution has, and who is near whom."""

import numpy as np
import pytest

from kedge.numerics.localisation import between, gaspari_cohn, neighbourhoods


def test_the_taper_is_the_self_convolution_of_a_cone():
    """Its definition in three dimensions, integrated numerically."""
    grid = np.linspace(-1.0, 1.0, 121)
    x, y, z = np.meshgrid(grid, grid, grid, indexing="ij")

    def cone(x):
        return np.maximum(1 - 2 * np.sqrt(x**2 + y**2 + z**2), 0.0)

    shifts = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9])
    overlap = np.array([np.sum(cone(x) * cone(x - shift)) for shift in shifts])
    # A cone of radius 1/2 against itself vanishes at distance 1.
    np.testing.assert_allclose(gaspari_cohn(shifts, 1.0), overlap / overlap[0], atol=2e-3)


def test_the_taper_is_smooth_and_ends():
    r = np.linspace(0.0, 3.0, 3001)
    taper = gaspari_cohn(r, 2.0)
    assert taper[0] == 1
    assert (taper[r >= 2] == 0).all()
    assert (np.diff(taper) <= 0).all()
    assert np.abs(np.diff(taper)).max() < 2e-3
    np.testing.assert_array_equal(gaspari_cohn(np.array([np.nan, 5.0]), 2.0), [1.0, 0.0])


@pytest.mark.parametrize("size", [12, 40])
def test_the_taper_is_a_correlation(size):
    """No negative eigenvalue, on a line and on a ring wide enough for it."""
    steps = np.abs(np.subtract.outer(np.arange(1.0 * size), np.arange(1.0 * size)))
    assert np.linalg.eigvalsh(gaspari_cohn(steps, 5.0)).min() > 0
    assert np.linalg.eigvalsh(gaspari_cohn(np.minimum(steps, size - steps), 5.0)).min() > 0


def test_neighbourhoods_hold_what_is_in_reach():
    distances = np.array([[0.0, 1.0, 2.0, np.nan], [9.0, 1.5, 0.5, np.nan]])
    near = neighbourhoods(distances, 2.0)
    weights = np.zeros((4, 2))
    np.put_along_axis(weights, near.places, near.weight, axis=1)
    np.testing.assert_array_equal(weights, gaspari_cohn(distances, 2.0).T)
    assert (weights[3] == 1).all()  # a component without a place listens to everything
    # As narrow as they can be.
    assert neighbourhoods(distances[:, :3], 1.0).places.shape == (3, 1)
    assert (neighbourhoods(distances[:1, 1:2], 0.5).weight == 0).all()


def test_measured_components_stand_where_their_nearest_one_does():
    places, measured = np.arange(6.0), np.array([1.0, 4.0, 5.0])
    distances = np.abs(np.subtract.outer(measured, places))
    distances = np.concatenate([distances, np.full((3, 1), np.nan)], axis=1)
    np.testing.assert_array_equal(
        between(distances), np.abs(np.subtract.outer(measured, measured))
    )


def test_distances_between_measured_components_are_the_same_both_ways():
    """At 1.4 and 4 among components at 0 to 5: 2.6 from one side and 3 from the other."""
    distances = np.abs(np.subtract.outer([1.4, 4.0], np.arange(6.0)))
    np.testing.assert_allclose(between(distances), [[0.4, 2.8], [2.8, 0.0]])
