"""Differences of squared ranges: exact without noise, in closed form with it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.positioning.fix import Status, bound
from kedge.positioning.linear import linear, linear_moments
from kedge.positioning.links import links
from kedge.positioning.solver import Solver

ROOM = np.array([[0.0, 0.0], [0.0, 6.0], [5.0, 0.0], [5.0, 6.0]])
SPACE = np.array([[0, 0, 2.0], [9, 0, 0.3], [9, 7, 2.5], [0, 7, 0.1], [4, 3, 3.0]])
POINTS = np.array([[0.6, 0.6], [0.6, 2.7], [0.6, 4.8], [1.8, 4.8], [3.0, 4.8]])
BIAS = np.array([0.114, 0.114, 0.0, 0.0])
STD = np.hypot([0.145, 0.145, 0.0262, 0.0262], 0.042)


def far(anchors, place):
    return np.linalg.norm(anchors - np.asarray(place), axis=1)


@pytest.fixture(scope="module")
def fixed():
    """One program for each way to weigh; the options are not traced."""

    @jax.jit
    def all_ways(epoch):
        ways = [
            linear(epoch, weighting, debias, reference)
            for weighting in ("none", "rows", "mean-square", "full")
            for debias in (False, True)
            for reference in (0, 3)
        ]
        return jnp.stack([fix.position for fix in ways]), ways[-1]

    return all_ways


@pytest.mark.parametrize(("anchors", "place"), [(ROOM, [1.8, 4.8]), (SPACE, [3.0, 2.0, 1.0])])
def test_without_noise_the_position_is_exact(fixed, anchors, place):
    # The known noise is taken from the squares, so there must be next to none.
    positions, fix = fixed(links(anchors, far(anchors, place), std=1e-9))
    np.testing.assert_allclose(positions, np.tile(place, (len(positions), 1)), atol=1e-9)
    assert int(fix.status) == Status.FIX
    assert int(fix.redundancy) == len(anchors) - len(place)
    np.testing.assert_allclose(fix.residual, 0.0, atol=1e-9)


def test_the_full_covariance_does_not_depend_on_the_reference():
    """Against the rows of each reference with their covariance, written out and inverted."""
    rng = np.random.default_rng(1)
    ranges = far(ROOM, [1.8, 4.8]) + BIAS + STD * rng.standard_normal(4)
    found = linear(links(ROOM, ranges, STD, BIAS)).position
    length = ranges - BIAS
    var = length**2 * STD**2 + STD**4 / 2
    squares = np.sum(ROOM**2, axis=1) - length**2 + STD**2
    for r in range(4):
        others = [i for i in range(4) if i != r]
        H = ROOM[others] - ROOM[r]
        B = (squares[others] - squares[r]) / 2
        W = np.linalg.inv(np.diag(var[others]) + var[r])
        np.testing.assert_allclose(found, np.linalg.solve(H.T @ W @ H, H.T @ W @ B), atol=1e-10)


def test_bias_and_covariance_are_those_of_many_draws():
    noise = np.random.default_rng(0).standard_normal((20000, 4))
    ranges = jnp.asarray(far(ROOM, POINTS[3]) + BIAS + STD * noise)
    ways = ("none", "rows", "mean-square")

    @jax.jit
    @jax.vmap
    def solve(own):
        epoch = links(ROOM, own, STD, BIAS)
        return jnp.stack([linear(epoch, way, False).position for way in ways])

    for found, way in zip(np.moveaxis(np.asarray(solve(ranges)), 1, 0), ways, strict=True):
        epoch = links(ROOM, np.ones(4), STD, BIAS)
        expected = linear_moments(epoch, jnp.asarray(POINTS[3]), way)
        error = found - POINTS[3]
        sem = np.sqrt(np.diag(expected.cov) / len(error))
        assert np.all(np.abs(error.mean(axis=0) - expected.bias) < 4 * sem)
        np.testing.assert_allclose(np.cov(error.T), expected.cov, rtol=0.05, atol=2e-4)


def test_the_closed_forms_of_the_room():
    """Figures of an independent implementation, from 20 000 draws a point."""
    drawn = [0.1448, 0.1314, 0.1717, 0.1832, 0.2066]
    epoch = links(ROOM, np.ones(4), STD, BIAS)
    found = [float(linear_moments(epoch, jnp.asarray(p)).rmse) for p in POINTS]
    np.testing.assert_allclose(found, drawn, rtol=0.01)
    least = [float(jnp.sqrt(jnp.trace(bound(epoch, jnp.asarray(p))))) for p in POINTS]
    np.testing.assert_allclose(least, [0.0752, 0.0686, 0.0716, 0.0679, 0.0671], atol=6e-5)


def test_as_printed_the_fix_is_moved_by_the_long_side():
    epoch = links(ROOM, far(ROOM, [1.8, 4.8]), std=1e-9)
    np.testing.assert_allclose(Solver("ls", printed=True).solve(epoch).position, [1.8, -1.2])
    np.testing.assert_allclose(Solver("ls").solve(epoch).position, [1.8, 4.8])


def test_a_common_height_cancels_and_a_known_one_is_taken_out():
    heights = np.array([2.5, 2.5, 1.0, 3.0])
    rise = 0.4 - heights
    ranges = np.sqrt(far(ROOM, [1.8, 4.8]) ** 2 + rise**2)
    found = linear(links(ROOM, ranges, std=1e-9, rise=rise)).position
    np.testing.assert_allclose(found, [1.8, 4.8], atol=1e-9)
    common = np.sqrt(far(ROOM, [1.8, 4.8]) ** 2 + 2.1**2)
    found = linear(links(ROOM, common, std=1e-9)).position
    np.testing.assert_allclose(found, [1.8, 4.8], atol=1e-9)
