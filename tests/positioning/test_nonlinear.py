"""The most likely position: against another library, and against the bound."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.positioning import losses
from kedge.positioning.differences import difference_bound, differences
from kedge.positioning.fix import Status, bound
from kedge.positioning.links import links
from kedge.positioning.mixture import Mixture, mixture
from kedge.positioning.solver import Solver

ROOM = np.array([[0.0, 0.0], [0.0, 6.0], [5.0, 0.0], [5.0, 6.0]])
HALL = np.array([[0, 0], [40, 0], [40, 20], [0, 20], [20, 0.0], [20, 20]])
PLACE = np.array([1.8, 4.8])


def far(anchors, place):
    return np.linalg.norm(anchors - np.asarray(place), axis=1)


def by_gtsam(anchors, ranges, std, loss, start):
    """The same least squares as a factor graph with one unknown."""
    gtsam = pytest.importorskip("gtsam")
    key = gtsam.symbol("x", 0)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(key, np.asarray(start, float))
    robust = {
        "huber": gtsam.noiseModel.mEstimator.Huber,
        "cauchy": gtsam.noiseModel.mEstimator.Cauchy,
    }
    for anchor, length, sigma in zip(anchors, ranges, std, strict=True):
        noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
        if loss != "l2":
            kind = robust[loss].Create(losses.TUNING[loss])
            noise = gtsam.noiseModel.Robust.Create(kind, noise)

        def error(this, values, jacobians, anchor=anchor, length=length):
            away = values.atVector(this.keys()[0]) - anchor
            distance = np.linalg.norm(away)
            if jacobians is not None:
                jacobians[0] = (away / distance)[None]
            return np.array([distance - length])

        graph.add(gtsam.CustomFactor(noise, [key], error))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(500)
    settings.setRelativeErrorTol(1e-15)
    settings.setAbsoluteErrorTol(1e-15)
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    return found.atVector(key)


@pytest.mark.parametrize("loss", ["l2", "huber", "cauchy"])
def test_it_is_what_a_factor_graph_finds(loss):
    rng = np.random.default_rng(4)
    solve = jax.jit(Solver("ml", loss=loss).solve)
    std = np.array([0.05, 0.1, 0.05, 0.2, 0.05, 0.1])
    for place in ([10.0, 7.0], [33.0, 4.0], [21.0, 18.0]):
        ranges = far(HALL, place) + std * rng.standard_normal(6)
        ranges[2] += 0.4
        fix = solve(links(HALL, ranges, std))
        other = by_gtsam(HALL, ranges, std, loss, np.asarray(place) + 0.3)
        np.testing.assert_allclose(fix.position, other, atol=1e-7)


def test_losses_have_the_weights_of_their_slopes():
    error = jnp.linspace(-9.0, 9.0, 40)
    for loss in losses.LOSSES:
        slope = jax.vmap(jax.grad(lambda e, loss=loss: losses.cost(loss, 2.0, e[None])[0]))(
            error
        )
        np.testing.assert_allclose(losses.weight(loss, 2.0, error) * error, slope, atol=1e-12)
        bend = jax.vmap(jax.grad(lambda e, loss=loss: losses.weight(loss, 2.0, e[None])[0] * e))
        weight = losses.weight(loss, 2.0, error)
        bent = np.clip(bend(error), 0.1 * weight, weight)
        np.testing.assert_allclose(losses.curvature(loss, 2.0, error), bent, atol=1e-12)
    with pytest.raises(ContractError, match="loss is 'l3', must be one of l2, huber"):
        Solver("ml", loss="l3")
    with pytest.raises(ContractError, match=r"no solver called 'mm'; there are ls"):
        Solver("mm")


def test_it_attains_the_bound_and_its_covariance_says_so():
    rng = np.random.default_rng(5)
    std = np.array([0.151, 0.151, 0.05, 0.05])
    ranges = far(ROOM, PLACE) + std * rng.standard_normal((4000, 4))
    fixes = jax.jit(jax.vmap(lambda own: Solver("ml").solve(links(ROOM, own, std))))(
        jnp.asarray(ranges)
    )
    error = np.asarray(fixes.position) - PLACE
    least = bound(links(ROOM, ranges[0], std), jnp.asarray(PLACE))
    # 4000 draws scatter by 1.6 % in a variance.
    np.testing.assert_allclose(np.sum(error**2) / 4000, np.trace(least), rtol=0.05)
    np.testing.assert_allclose(np.mean(fixes.crlb**2), np.trace(least), rtol=0.01)
    inverse = np.linalg.inv(np.asarray(fixes.cov))
    assert np.einsum("ni,nij,nj->n", error, inverse, error).mean() == pytest.approx(2, rel=0.07)
    assert (np.asarray(fixes.status) == Status.FIX).all()


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey", "geman-mcclure"])
def test_one_strong_obstacle_among_eight_anchors_is_forgiven(loss):
    anchors = np.vstack([ROOM, [[0, 3], [5, 3], [2.5, 0], [2.5, 6]]])
    ranges = far(anchors, PLACE)
    ranges[5] += 1.5
    solve = jax.jit(Solver("ml", loss=loss).solve)
    fix = solve(links(anchors, ranges, 0.05))
    plain = Solver("ml").solve(links(anchors, ranges, 0.05))
    gap = np.linalg.norm(fix.position - PLACE)
    assert gap < (0.06 if loss == "huber" else 1e-2)
    assert np.linalg.norm(plain.position - PLACE) > 0.3
    assert float(fix.residual[5]) == pytest.approx(1.5, abs=0.1)


def test_the_mixture_tells_the_blocked_range():
    anchors = np.vstack([ROOM, [[0, 3], [5, 3]]])
    ranges = far(anchors, PLACE)
    ranges[4] += 0.6
    fix = mixture(links(anchors, ranges, 0.05), Mixture(0.5, 0.3, 0.2))
    np.testing.assert_allclose(fix.position, PLACE, atol=0.02)
    clean = mixture(links(anchors, far(anchors, PLACE), 0.05), Mixture(0.5, 0.3, 0.2))
    np.testing.assert_allclose(clean.position, PLACE, atol=5e-3)


def test_differences_reach_their_bound_inside_and_out():
    """For four corners of a hall and 5 cm; the figures are of an independent program."""
    corners, rng = HALL[:4], np.random.default_rng(6)
    solve = jax.jit(jax.vmap(lambda own: differences(links(corners, own, 0.05))))
    for place, figure in (([20.0, 10.0], 0.057), ([-5.0, 10.0], 0.102), ([45.0, 25.0], 0.285)):
        noisy = far(corners, place) + 0.05 * rng.standard_normal((3000, 4))
        fixes = solve(jnp.asarray(noisy - noisy[:, :1]))
        error = np.asarray(fixes.position) - place
        least = np.trace(difference_bound(links(corners, noisy[0], 0.05), jnp.asarray(place)))
        rmse = np.sqrt(np.mean(np.sum(error**2, axis=1)))
        assert rmse == pytest.approx(np.sqrt(least), rel=0.06)
        assert rmse == pytest.approx(figure, rel=0.25)
        assert fixes.redundancy[0] == 1


def test_differences_are_weighed_by_the_covariance_they_share():
    r"""Against one reference it is $\sigma^2 (I + 1 1^\top)$; least squares with it by hand.

    As independent differences they would lead elsewhere, and to a smaller covariance.
    """
    rng, place = np.random.default_rng(7), np.array([31.0, 4.0])
    noisy = far(HALL, place) + 0.3 * rng.standard_normal(6)
    noisy[3] += 1.0
    fix = differences(links(HALL, noisy - noisy[0], 0.3))

    def by_hand(cov):
        found, weight = place.copy(), np.linalg.inv(cov)
        for _ in range(60):
            unit = (found - HALL) / far(HALL, found)[:, None]
            slope = unit[1:] - unit[0]
            left = noisy[1:] - noisy[0] - (far(HALL, found)[1:] - far(HALL, found)[0])
            inverse = np.linalg.inv(slope.T @ weight @ slope)
            found = found + inverse @ slope.T @ weight @ left
        return found, inverse

    shared, cov = by_hand(0.3**2 * (np.eye(5) + 1.0))
    np.testing.assert_allclose(fix.position, shared, atol=1e-6)
    np.testing.assert_allclose(fix.cov, cov, rtol=1e-6)
    alone, smaller = by_hand(0.3**2 * np.eye(5))
    assert np.linalg.norm(alone - shared) > 0.05
    assert np.trace(smaller) < 0.8 * np.trace(cov)


def test_the_covariance_of_differences_is_that_of_the_errors():
    """2000 draws know a mean of two squared normal variables to 2.2 %."""
    rng, place = np.random.default_rng(8), np.array([31.0, 4.0])
    noisy = far(HALL, place) + 0.05 * rng.standard_normal((2000, 6))
    solve = jax.jit(jax.vmap(lambda own: differences(links(HALL, own, 0.05))))
    fixes = solve(jnp.asarray(noisy - noisy[:, :1]))
    error = np.asarray(fixes.position) - place
    inverse = np.linalg.inv(np.asarray(fixes.cov))
    assert np.einsum("ni,nij,nj->n", error, inverse, error).mean() == pytest.approx(2, rel=0.07)
