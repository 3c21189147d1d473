"""Where to hang anchors, against the bound of one fix and against all layouts."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.calibration.placement import area, blocked, bounds, chosen
from kedge.core.errors import DataError
from kedge.positioning.fix import bound
from kedge.positioning.links import links

CORNERS = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0]])
GRID = np.array(list(itertools.product(np.arange(1.0, 20.0, 2), np.arange(1.0, 10.0, 2))))
RIM = np.array(
    [(x, y) for x in np.arange(0.0, 21.0, 4) for y in (0.0, 10.0)] + [(0.0, 5.0), (20.0, 5.0)]
)
WALL = [[[8.0, 0.0], [8.0, 7.5]]]


def mean_square(found):
    return np.sqrt(np.mean(found**2))


def test_the_map_is_the_bound_of_a_fix():
    hall = area(GRID, std=0.05)
    found = bounds(hall, CORNERS)
    for place, ours in list(zip(GRID, found, strict=True))[::11]:
        far = np.linalg.norm(CORNERS - place, axis=1)
        other = bound(links(CORNERS, far, 0.05), jnp.asarray(place))
        assert ours == pytest.approx(float(np.sqrt(np.trace(other))), rel=1e-9)


def test_a_wall_blocks_what_is_behind_it():
    hall = area([[4.0, 5.0], [4.0, 9.0]], WALL)
    anchors = np.array([[20.0, 5.0], [20.0, 9.0], [0.0, 5.0]])
    np.testing.assert_array_equal(
        blocked(hall, anchors), [[True, True, False], [False, False, False]]
    )


def test_behind_a_wall_with_one_anchor_in_sight_there_is_no_fix():
    hall = area([[4.0, 1.0]], WALL)
    assert np.isinf(bounds(hall, [[20.0, 1.0], [20.0, 2.0], [0.0, 1.0]])).all()


def test_better_than_the_corners_in_a_room_with_a_wall():
    hall = area(GRID, WALL, blocked_std=1.0)
    own = RIM[chosen(hall, RIM, 4)]
    assert mean_square(bounds(hall, own)) < 0.9 * mean_square(bounds(hall, CORNERS))


def test_as_good_as_the_best_of_all_layouts():
    hall = area(GRID, WALL, blocked_std=1.0)
    own = mean_square(bounds(hall, RIM[chosen(hall, RIM, 3)]))
    layouts = itertools.combinations(range(len(RIM)), 3)
    best = min(mean_square(bounds(hall, RIM[list(some)])) for some in layouts)
    assert own == pytest.approx(best, rel=0.02)


@pytest.mark.parametrize("count", [1, len(RIM) + 1])
def test_a_number_of_anchors_that_makes_no_sense(count):
    with pytest.raises(DataError, match="placement"):
        chosen(area(GRID), RIM, count)


def test_no_places():
    with pytest.raises(DataError, match="places"):
        area(np.zeros((0, 2)))
