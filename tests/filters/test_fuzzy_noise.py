"""Fuzzy adaptation of measurement noise: rules, direction, and where it settles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.published.fuzzy_noise import RULES, FuzzyNoise
from kedge.numerics.fuzzy import inferred
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import ConstantVelocity, Control, Noise

VEHICLE = ConstantVelocity(acceleration_noise=0.1)
PRIOR = Gaussian(VEHICLE.start(), jnp.eye(4))


def settled(std, window=50.0, steps=2000, **bounds):
    """Factors and NIS of a filter that thinks the noise is 1 m when it is ``std``."""
    filter, sensor = FuzzyNoise(Kalman(), window, **bounds), Gnss(std=1.0)

    def body(carry, key):
        state, belief = carry
        shock, error = jax.random.normal(key, (2, 2))
        state = VEHICLE.step(state, Control(), Noise(0.1 * shock), 1.0)
        belief = filter.predict(VEHICLE, belief, Control(), 1.0, key)
        seen = Measurement(state.position + std * error)
        belief, score = filter.update(sensor, belief, seen, key)
        return (state, belief), (belief.factor[""], belief.ratio[""], score.nis)

    keys = jax.random.split(jax.random.key(5), steps)
    start = VEHICLE.start(), filter.init(PRIOR, keys[0])
    return jax.lax.scan(body, start, keys)[1]


run = quick_jit(settled)


@pytest.mark.parametrize("std", [3.0, 1.0, 0.4])
def test_it_settles_at_the_true_noise(std):
    factors, ratios, _ = run(std)
    # Averages over about 1,500 readings of two components; neighbours hang together for 50.
    np.testing.assert_allclose(np.mean(factors[500:]), std**2, rtol=0.12)
    np.testing.assert_allclose(np.mean(ratios[500:]), 1.0, atol=0.05)


def test_what_is_reported_is_under_the_nominal_noise(key):
    filter = FuzzyNoise(Kalman())
    seen = Measurement(jnp.array([3.0, -4.0]))

    @quick_jit
    def both():
        belief = filter.init(PRIOR, key)
        belief = belief._replace(factor={"": jnp.asarray(4.0)})
        return (
            filter.update(Gnss(std=1.0), belief, seen, key),
            Kalman().update(Gnss(std=1.0), PRIOR, seen, key)[1],
            Kalman().update(Gnss(std=2.0), PRIOR, seen, key)[0],
        )

    (after, score), nominal, with_twice = both()
    for one, other in zip(jax.tree.leaves(score), jax.tree.leaves(nominal), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(after.moments().cov, with_twice.cov, rtol=1e-12)
    np.testing.assert_allclose(
        after.moments().mean.position, with_twice.mean.position, rtol=1e-12
    )


def test_bounds_hold():
    factors, *_ = quick_jit(lambda: settled(30.0, steps=400, ceiling=9.0))()
    assert factors.max() == 9.0


def test_the_rules_are_odd_and_interpolated():
    table = quick_jit(lambda value: inferred(value, RULES))
    for centre, change in RULES.items():
        np.testing.assert_allclose(table(centre), change)
        np.testing.assert_allclose(table(-centre), -change)
    np.testing.assert_allclose(table(1.4), 0.6 * 0.25 + 0.4 * 1.0)  # two rules fire
    np.testing.assert_allclose(table(50.0), 1.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"window": 0.5}, "fuzzy-noise: window is 0.5, must be at least 1"),
        ({"floor": 3.0, "ceiling": 2.0}, "fuzzy-noise: floor is 3 and ceiling 2"),
    ],
)
def test_bad_parameters(given, message):
    with pytest.raises(ContractError, match=message):
        FuzzyNoise(**given)
