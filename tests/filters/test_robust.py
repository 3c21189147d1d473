"""Student-t weights: outliers are weighed down, good readings as ever."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.wrappers.robust import Robust
from kedge.numerics.losses import Loss
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import Unicycle

PRIOR = Gaussian(Unicycle().start(), 0.5 * jnp.eye(3))


@pytest.fixture(scope="module")
def update():
    from jax.random import key

    def both(filter, std, place):
        return filter.update(Gnss(std=std), PRIOR, Measurement(place), key(0))

    robust = quick_jit(lambda dof, place: both(Robust(tuning=dof), 1.0, place))
    plain = quick_jit(lambda std, place: both(ExtendedKalman(), std, place))
    return robust, plain


def test_an_outlier_is_fused_with_the_noise_that_its_size_calls_for(update):
    """S = 1.5 I, so NIS = 36 / 1.5 = 24: R is multiplied by (4 + 24) / (4 + 2)."""
    robust, plain = update
    place = np.array([6.0, 0.0])
    (one, score), (other, _) = robust(4.0, place), plain(np.sqrt(28 / 6), place)
    np.testing.assert_allclose(one.mean.position, other.mean.position, rtol=1e-12)
    np.testing.assert_allclose(one.cov, other.cov, rtol=1e-12, atol=1e-15)
    # What is reported is the innovation under the nominal noise, for gates and tests.
    np.testing.assert_allclose(score.nis, 24)


def test_a_good_reading_is_not_trusted_more_than_its_noise(update):
    robust, plain = update
    place = np.array([0.1, -0.2])
    (one, _), (other, _) = robust(4.0, place), plain(1.0, place)
    np.testing.assert_allclose(one.cov, other.cov, rtol=1e-14, atol=1e-16)


def test_many_degrees_of_freedom_are_gaussian(update):
    robust, plain = update
    place = np.array([6.0, 0.0])
    (one, _), (other, _) = robust(1e12, place), plain(1.0, place)
    np.testing.assert_allclose(one.mean.position, other.mean.position, rtol=1e-9)


def test_the_pull_of_an_outlier_is_bounded(update):
    """The farther, the less: a Gaussian update would go along for ever."""
    robust, _ = update
    pulls = [
        float(robust(4.0, np.array([x, 0.0]))[0].mean.position[0]) for x in (3.0, 30.0, 3e3)
    ]
    assert pulls[0] > pulls[1] > pulls[2] > 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"tuning": 0.0}, "tuning is 0, must be above 0, e.g. 4"),
        ({"loss": "hubert"}, "loss is 'hubert', must be one of student, huber, cauchy"),
        ({"side": "left"}, "side is 'left', must be one of both, positive, negative"),
    ],
)
def test_losses_that_do_not_exist(given, message):
    with pytest.raises(ContractError, match=message):
        Robust(**given)


def location(loss, tuning, readings):
    """The M-estimate of a constant: psi(x) = x w(x), and w = 1 / factor."""

    def weigh(centre, _):
        def weight(reading):
            residual = (reading - centre)[None]
            return 1 / Loss(loss, tuning).factor(residual, jnp.eye(1), 1)

        weights = jax.vmap(weight)(readings)
        return jnp.sum(weights * readings) / jnp.sum(weights), None

    return jax.lax.scan(weigh, jnp.median(readings), None, length=15)[0]


PENALTIES = {
    "student": lambda x, v: (v + 1) / 2 * jnp.log(1 + x**2 / v),
    "huber": lambda x, c: c * jnp.abs(x) - c**2 / 2,
    "cauchy": lambda x, c: c**2 / 2 * jnp.log(1 + x**2 / c**2),
    "geman-mcclure": lambda x, c: x**2 / 2 / (1 + x**2 / c**2),
}
"""What an estimator with the loss minimises, beyond one or c standard deviations."""


@pytest.mark.parametrize("loss", PENALTIES)
def test_the_pull_of_a_residual_is_the_slope_of_what_is_minimised(loss):
    for residual in (2.6, -4.0, 9.0):
        pull = residual / Loss(loss, 2.5).factor(jnp.array([residual]), jnp.eye(1), 1)
        np.testing.assert_allclose(pull, jax.grad(PENALTIES[loss])(residual, 2.5), rtol=1e-12)


@pytest.mark.parametrize("loss", ["huber", "cauchy", "geman-mcclure"])
def test_the_default_scale_costs_a_twentieth_where_noise_is_gaussian(loss, key):
    """The variance of the mean, 1 / n, over that of the estimate: 95 % by each default."""
    draws = jax.random.normal(key, (4000, 50))
    found = quick_jit(jax.vmap(lambda rows: location(loss, None, rows)))(draws)
    efficiency = 1 / 50 / float(jnp.mean(found**2))
    # 4,000 draws know a variance to 2.2 %; 50 readings are not yet the asymptote.
    assert 0.90 < efficiency < 1.0


def test_a_side_weighs_down_only_what_errs_on_it(key):
    cov = jnp.diag(jnp.array([4.0, 1.0]))
    too_long, mixed = jnp.array([8.0, 3.0]), jnp.array([8.0, -3.0])
    one_sided = Loss("cauchy", 2.0, "positive")
    np.testing.assert_allclose(one_sided.factor(too_long, cov, 2), 1 + (16 + 9) / 4)
    np.testing.assert_allclose(one_sided.factor(mixed, cov, 2), 1 + 16 / 4)
    np.testing.assert_allclose(one_sided.factor(-too_long, cov, 2), 1.0)
    np.testing.assert_allclose(
        Loss("cauchy", 2.0, "negative").factor(-too_long, cov, 2), 1 + (16 + 9) / 4
    )
