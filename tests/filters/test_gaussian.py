"""The recursion of the Gaussian filters against answers that need no filter formula."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.registry import filters
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.gaussian.unscented import UnscentedKalman
from kedge.sensors.gnss import Gnss, Measurement
from kedge.sensors.landmarks import Landmarks
from kedge.sensors.landmarks import Measurement as Sight
from kedge.testing import quick_jit
from kedge.vehicles import constant_velocity, unicycle

# The others give what the Kalman filter gives on a linear model: tests/laws.
every_filter = pytest.mark.parametrize("name", ["kalman", "unscented", "square-root"])


@every_filter
def test_update_weighs_by_inverse_variance(name, key):
    """Independent scalar fusions: 1 / P' = 1 / P + 1 / R, and a weighted average."""
    prior = Gaussian(
        unicycle.State(jnp.zeros(2), jnp.array(0.3)), jnp.diag(jnp.array([2.0, 1.0, 0.1]))
    )
    fix = Measurement(jnp.array([1.0, 2.0]))

    @quick_jit
    def update(prior, fix):
        filter = filters.make(name)
        belief, score = filter.update(Gnss(std=2**0.5), filter.init(prior, key), fix, key)
        return belief.moments(), score

    posterior, innovation = update(prior, fix)

    np.testing.assert_allclose(posterior.mean.position, [1 / 2, 2 / 3])
    np.testing.assert_allclose(posterior.cov, np.diag([1.0, 2 / 3, 0.1]), atol=1e-14)
    np.testing.assert_allclose(posterior.mean.heading, 0.3)
    np.testing.assert_allclose(innovation.residual, [1.0, 2.0])
    np.testing.assert_allclose(innovation.cov, np.diag([4.0, 3.0]), atol=1e-14)
    np.testing.assert_allclose(innovation.nis, 1 / 4 + 4 / 3)


@every_filter
def test_prediction_spreads_by_the_speed(name, key):
    """Var[p + v T] = Var p + T^2 Var v, and what white acceleration held for T adds."""
    vehicle = constant_velocity.ConstantVelocity(acceleration_noise=0.5)
    prior = Gaussian(vehicle.start(), jnp.diag(jnp.array([1.0, 2.0, 0.3, 0.4])))

    @quick_jit
    def predict(prior):
        control = constant_velocity.Control()
        filter = filters.make(name)
        belief = filter.init(prior, key)
        return filter.predict(vehicle, belief, control, 2.0, key).moments()

    after = predict(prior)
    np.testing.assert_allclose(after.mean.position, [2.0, 1.0])
    np.testing.assert_allclose(after.mean.velocity, [1.0, 0.5])
    # Var w = 0.25 / 2 acts as T^2/2 = 2 on the position and as T = 2 on the velocity.
    expected = np.array(
        [
            [1 + 4 * 0.3 + 0.5, 0, 2 * 0.3 + 0.5, 0],
            [0, 2 + 4 * 0.4 + 0.5, 0, 2 * 0.4 + 0.5],
            [2 * 0.3 + 0.5, 0, 0.3 + 0.5, 0],
            [0, 2 * 0.4 + 0.5, 0, 0.4 + 0.5],
        ]
    )
    np.testing.assert_allclose(after.cov, expected, atol=2e-14)


@every_filter
@pytest.mark.parametrize(
    ("length", "gain", "predicted"),
    [
        (1.0, [0.75, 0.5], [[3.0, 2.0], [2.0, 2.0]]),
        (0.1, [0.36, 0.08], None),
    ],
)
def test_steady_state_is_the_alpha_beta_filter(name, length, gain, predicted, key):
    """Law 13: T = 1, R = 1, Q = L^2 [[1/4, 1/2], [1/2, 1]] has gains in closed form.

    L^2 is the tracking index squared; alpha and beta satisfy L^2 = beta^2 / (1 - alpha) and
    beta = 2 (2 - alpha) - 4 sqrt(1 - alpha) (Kalata, 1984).
    """
    alpha, beta = gain
    np.testing.assert_allclose(beta**2 / (1 - alpha), length**2)
    np.testing.assert_allclose(beta, 2 * (2 - alpha) - 4 * np.sqrt(1 - alpha))
    filter, seen = filters.make(name), Measurement(jnp.zeros(2))

    @quick_jit
    def cycle(belief, density):
        vehicle = constant_velocity.ConstantVelocity(acceleration_noise=density)
        before = filter.predict(vehicle, belief, constant_velocity.Control(), 1.0, key)
        after = filter.update(Gnss(std=1.0), before, seen, key)[0]
        return before.moments(), after.moments(), after

    start = constant_velocity.ConstantVelocity().start()
    belief, before, after = filter.init(Gaussian(start, jnp.eye(4)), key), None, None
    for _ in range(120):
        before, after, belief = cycle(belief, length)
    for axis in (0, 1):  # east and north are two such filters
        pair = np.ix_([axis, axis + 2], [axis, axis + 2])
        # With R = 1 the gain is the first column of the posterior covariance.
        np.testing.assert_allclose(after.cov[pair][:, 0], gain, rtol=1e-9)
        if predicted is not None:
            np.testing.assert_allclose(before.cov[pair], predicted, rtol=1e-9)


def test_kalman_refuses_a_nonlinear_vehicle(key):
    vehicle = unicycle.Unicycle()
    prior = Gaussian(vehicle.start(), jnp.eye(3))
    with pytest.raises(ContractError, match=r"unicycle\.State depends nonlinearly.*'extended'"):
        Kalman().predict(vehicle, prior, vehicle.nominal_control(0.0), 0.1, key)


def test_kalman_refuses_a_nonlinear_sensor(key):
    prior = Gaussian(unicycle.Unicycle().start(), jnp.eye(3))
    seen = Sight(jnp.array(1.0), jnp.array(0.0))
    with pytest.raises(ContractError, match=r"landmarks\.Measurement depends nonlinearly"):
        Kalman().update(Landmarks().for_target(0), prior, seen, key)


def test_unscented_refuses_parameters_without_points():
    with pytest.raises(ContractError, match=r"unscented rule of size 1.*alpha=0"):
        UnscentedKalman(alpha=0.0)
    # More than one noise and state make kappa = -2 impossible too, but only then.
    assert UnscentedKalman(kappa=-0.5).kappa == -0.5


def test_dead_reckoning_scores_and_keeps(key):
    prior = Gaussian(unicycle.Unicycle().start(), 3.0 * jnp.eye(3))
    fix = Measurement(jnp.array([1.0, 2.0]))
    kept, innovation = quick_jit(
        lambda prior, fix: filters.make("dead-reckoning").update(Gnss(std=1.0), prior, fix, key)
    )(prior, fix)
    np.testing.assert_array_equal(kept.cov, prior.cov)
    np.testing.assert_array_equal(kept.mean.position, prior.mean.position)
    np.testing.assert_allclose(innovation.nis, 5 / 4)
    assert not innovation.accepted
