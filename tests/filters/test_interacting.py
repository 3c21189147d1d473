"""Interacting multiple models against closed forms, and on a target that manoeuvres."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy

from kedge.core.beliefs import Gaussian, Mixture
from kedge.core.errors import ContractError
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.gaussian.square_root import SquareRootKalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.filters.wrappers.interacting import InteractingModels
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import ConstantVelocity, Control
from kedge.vehicles.unicycle import Unicycle

CALM = ConstantVelocity(acceleration_noise=0.2)
PRIOR = Gaussian(CALM.start(), jnp.diag(jnp.array([2.0, 1.0, 0.5, 0.5])))
FIX = Measurement(jnp.array([1.7, -0.4]))


def cycle(filter, prior, key, dt=1.0):
    belief = filter.predict(CALM, filter.init(prior, key), Control(), dt, key)
    return belief, *filter.update(Gnss(std=0.5), belief, FIX, key)


@pytest.mark.parametrize("inner", [Kalman(), SquareRootKalman(Kalman())])
def test_modes_that_move_alike_are_the_inner_filter(inner, key):
    @quick_jit
    def both(prior):
        mixed = InteractingModels(inner, vehicles=(CALM, CALM, CALM))
        return cycle(mixed, prior, key), cycle(Kalman(), prior, key)

    (_, mixture, score), (_, plain, exact) = both(PRIOR)
    moments = mixture.moments()
    for a, b in zip(jax.tree.leaves(moments), jax.tree.leaves(plain), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(np.exp(mixture.log_weights), [1 / 3] * 3, rtol=1e-12)
    np.testing.assert_allclose(score.nis, exact.nis, rtol=1e-12)
    np.testing.assert_allclose(score.log_likelihood, exact.log_likelihood, rtol=1e-12)


def test_modes_are_weighed_by_the_density_that_they_gave_the_reading(key):
    """The predictive densities written down with scipy: F P F' + Q + R by mode."""
    belief, after, score = quick_jit(
        lambda prior: cycle(InteractingModels(Kalman(), noise=20.0), prior, key)
    )(PRIOR)
    np.testing.assert_allclose(np.exp(belief.log_weights), [0.5, 0.5], rtol=1e-12)
    densities = []
    for density in (0.2, 4.0):
        spread = np.diag([2.0 + 0.5, 1.0 + 0.5]) + np.eye(2) * (density**2 / 4 + 0.25)
        mean = np.asarray(PRIOR.mean.position) + np.asarray(PRIOR.mean.velocity)
        densities.append(scipy.stats.multivariate_normal(mean, spread).pdf(FIX.position))
    np.testing.assert_allclose(
        np.exp(after.log_weights), np.array(densities) / sum(densities), rtol=1e-10
    )
    np.testing.assert_allclose(score.log_likelihood, np.log(np.mean(densities)), rtol=1e-10)


def test_moments_are_those_of_samples(key):
    parts = Gaussian(
        jax.tree.map(lambda leaf: jnp.stack([leaf, leaf + 3.0]), PRIOR.mean),
        jnp.stack([PRIOR.cov, 0.1 * jnp.eye(4)]),
    )
    found = quick_jit(lambda parts: Mixture(parts, jnp.log(jnp.array([0.3, 0.7]))).moments())(
        parts
    )
    rng = np.random.default_rng(0)
    flat = np.concatenate([parts.mean.position, parts.mean.velocity], axis=1)
    which = rng.random(200_000) < 0.3
    draws = np.where(
        which[:, None],
        rng.multivariate_normal(flat[0], parts.cov[0], 200_000),
        rng.multivariate_normal(flat[1], parts.cov[1], 200_000),
    )
    np.testing.assert_allclose(found.mean.velocity, draws.mean(axis=0)[2:], atol=0.02)
    np.testing.assert_allclose(found.cov, np.cov(draws.T), atol=0.05)


def test_switching_does_not_depend_on_how_time_is_cut():
    filter = InteractingModels(sojourn=3.0, vehicles=(CALM, CALM, CALM))
    whole, half = filter._switching(1.0), filter._switching(0.5)
    np.testing.assert_allclose(half @ half, whole, rtol=1e-12)
    np.testing.assert_allclose(whole.sum(axis=1), 1.0)
    # Rate of leaving is 1 / sojourn.
    np.testing.assert_allclose((1 - filter._switching(1e-6)[0, 0]) / 1e-6, 1 / 3, rtol=1e-5)


@pytest.mark.slow
def test_a_manoeuvre_is_followed_better_than_by_either_motion_alone(key):
    """Straight, a turn of 9 s, straight: position RMSE over 40 runs with common noise."""
    steps = np.arange(1, 61)
    rate = np.where((steps > 25) & (steps <= 34), np.pi / 18, 0.0)
    heading = np.cumsum(rate)
    path = np.cumsum(8 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    readings = path[None] + 3.0 * jr.normal(key, (40, 60, 2))
    start = PRIOR.mean._replace(position=jnp.zeros(2), velocity=jnp.array([8.0, 0.0]))

    def error(filter, vehicle):
        def one(fixes, key):
            def body(belief, fix):
                belief = filter.predict(vehicle, belief, Control(), 1.0, key)
                belief, _ = filter.update(Gnss(std=3.0), belief, Measurement(fix), key)
                return belief, belief.moments().mean.position

            return jax.lax.scan(body, filter.init(Gaussian(start, 4 * jnp.eye(4)), key), fixes)

        _, found = quick_jit(jax.vmap(one, (0, None)))(readings, key)
        return np.sqrt(np.mean(np.sum((found - path[None]) ** 2, axis=2)))

    calm, wild = (ConstantVelocity(acceleration_noise=q) for q in (0.1, 1.5))
    alone = [error(Kalman(), vehicle) for vehicle in (calm, wild)]
    assert error(InteractingModels(Kalman(), noise=15.0), calm) < 0.93 * min(alone)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"noise": 0.0}, "noise is 0, must be above 0"),
        ({"sojourn": -1.0}, "sojourn is -1, must be above 0"),
        ({"vehicles": (CALM,)}, "1 vehicles, expected at least 2"),
        ({"inner": BootstrapParticle(count=5)}, "BootstrapParticle, which carries no Gaussian"),
    ],
)
def test_models_that_cannot_interact(given, message):
    with pytest.raises(ContractError, match=message):
        InteractingModels(**given)


def test_modes_of_another_state_are_refused(key):
    filter = InteractingModels(vehicles=(CALM, Unicycle()))
    with pytest.raises(ContractError, match=r"state of Unicycle is a State, expected"):
        filter.predict(CALM, filter.init(PRIOR, key), Control(), 1.0, key)
