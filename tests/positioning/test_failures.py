"""What cannot be solved is flagged, and mirror images are both told."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.positioning.fix import Status
from kedge.positioning.links import Use, links
from kedge.positioning.solver import Solver, solve_all

ROOM = np.array([[0.0, 0.0], [0.0, 6.0], [5.0, 0.0], [5.0, 6.0]])
LINE = np.array([[0.0, 0.0], [2.0, 1.0], [4.0, 2.0], [8.0, 4.0]])
CEILING = np.array([[0, 0, 3.0], [9, 0, 3.0], [9, 7, 3.0], [0, 7, 3.0]])
NAMES = ["ls", "gls", "ml"]


def far(anchors, place):
    return np.linalg.norm(anchors - np.asarray(place), axis=1)


@pytest.fixture(scope="module")
def solve():
    programs = {name: jax.jit(Solver(name).solve) for name in NAMES}
    return lambda name, epoch, near=None: programs[name](epoch, near)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("anchors", "place", "image"),
    [(LINE, [3.0, 4.0], [5.0, 0.0]), (CEILING, [2.0, 3.0, 1.2], [2.0, 3.0, 4.8])],
)
def test_anchors_on_a_line_or_plane_leave_two_positions(solve, name, anchors, place, image):
    fix = solve(name, links(anchors, far(anchors, place), std=1e-6))
    assert int(fix.status) == Status.AMBIGUOUS
    assert bool(fix.ambiguous)
    both = sorted(np.round([np.asarray(fix.position), np.asarray(fix.mirror)], 6).tolist())
    assert both == sorted([place, image])
    # The lower one, unless it is told where to look.
    assert fix.position[-1] < fix.mirror[-1]
    near = solve(name, links(anchors, far(anchors, place), std=1e-6), jnp.asarray(image) + 0.5)
    np.testing.assert_allclose(near.position, image, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_as_many_ranges_as_unknowns_leave_two_and_fewer_none(solve, name):
    ranges = far(ROOM, [1.8, 4.8])
    two = solve(name, links(ROOM, [np.nan, np.nan, *ranges[2:]], std=1e-6))
    assert int(two.status) == Status.AMBIGUOUS
    both = np.stack([two.position, two.mirror])
    np.testing.assert_allclose(np.sort(both[:, 0]), [1.8, 8.2], atol=1e-6)
    one = solve(name, links(ROOM, [np.nan, np.nan, np.nan, ranges[3]], std=0.1))
    assert int(one.status) == Status.TOO_FEW
    assert int(one.redundancy) == -1
    assert np.isnan(one.position).all()
    assert np.isnan(one.cov).all()


@pytest.mark.parametrize("name", NAMES)
def test_bad_ranges_are_left_out_and_named(solve, name):
    ranges = far(ROOM, [1.8, 4.8])
    for bad, why in (
        (-1.0, Use.NOT_POSITIVE),
        (0.0, Use.NOT_POSITIVE),
        (np.inf, 2),
        (np.nan, 1),
    ):
        fix = solve(name, links(ROOM, [bad, *ranges[1:]], std=1e-9))
        assert fix.use.tolist() == [int(why), 0, 0, 0]
        np.testing.assert_allclose(fix.position, [1.8, 4.8], atol=1e-8)
        assert np.isnan(fix.residual).tolist() == [True, False, False, False]
    short = solve(name, links(ROOM, [0.5, *ranges[1:]], std=1e-9, rise=[0.7, 0.0, 0.0, 0.0]))
    assert short.use.tolist() == [int(Use.SHORT), 0, 0, 0]


def test_epochs_do_not_touch_one_another():
    """Many at once, each with other anchors missing, are as one after the other."""
    rng = np.random.default_rng(3)
    anchors = rng.uniform(0, 20, (6, 2))
    places = rng.uniform(0, 20, (40, 2))
    ranges = np.linalg.norm(
        places[:, None] - anchors[None], axis=2
    ) + 0.05 * rng.standard_normal((40, 6))
    ranges[rng.random((40, 6)) < 0.3] = np.nan
    epochs = jax.vmap(lambda own: links(anchors, own, 0.05))(jnp.asarray(ranges))
    solver = Solver("ml")
    all_ = solve_all(solver, epochs)
    one = jax.jit(solver.solve)
    for row in range(40):
        alone = one(links(anchors, ranges[row], 0.05))
        np.testing.assert_allclose(all_.position[row], alone.position, atol=1e-9)
    there = np.isfinite(ranges).sum(axis=1)
    few = np.asarray(all_.status) == Status.TOO_FEW
    assert few.tolist() == (there < 2).tolist()
    clear = np.asarray(all_.status) == Status.FIX
    error = np.linalg.norm(np.asarray(all_.position) - places, axis=1)
    assert clear.sum() > 20
    assert np.all(error[clear] < 5 * np.asarray(all_.crlb)[clear])
