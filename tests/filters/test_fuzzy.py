"""The fuzzy Kalman filter: what its rules must share with filters that have none."""

import warnings
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import Speed
from kedge.core.registry import filters, sensors, vehicles
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.published.fuzzy import FuzzyKalman
from kedge.numerics.fuzzy import corners, memberships
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import ConstantVelocity
from kedge.vehicles.constant_velocity import Control as Nobody
from kedge.vehicles.constant_velocity import State as Moving


class Hull(NamedTuple):
    surge: Speed
    sway: Speed


class Thrust(NamedTuple):
    force: Speed


class Ship(AbstractVehicle[Hull, Thrust, Hull]):
    """Quadratic in its velocities: signed drag, and each turns the other, in Euler steps."""

    def step(self, state, control, noise, dt):
        u, v = state
        surge = -0.3 * u * jnp.abs(u) + 0.2 * u * v + control.force + noise.surge
        sway = -0.5 * v * jnp.abs(v) - 0.1 * u**2 + noise.sway
        return Hull(u + dt * surge, v + dt * sway)

    def noise_density(self):
        return Hull(0.1, 0.2)

    def start(self):
        return Hull(jnp.array(0.8), jnp.array(0.3))

    def nominal_control(self, time):
        return Thrust(jnp.array(0.4))


AT = np.array([0.8, 0.3])
COV = np.array([[0.05, 0.01], [0.01, 0.02]])
ONE_SIGNED = {"surge": (0.0, 1.5), "sway": (0.0, 1.0)}
ACROSS = {"surge": (-1.5, 1.5), "sway": (-1.0, 1.0)}
DT = 0.1


def made(**parameters):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return FuzzyKalman(**parameters)


def predicted(**parameters):
    """The reported moments after one prediction, and the rules."""
    filter = made(**parameters)

    @quick_jit
    def run(cov):
        belief = filter.init(Gaussian(Ship().start(), cov), jr.key(0))
        return filter.predict(Ship(), belief, Ship().nominal_control(0.0), DT, jr.key(0))

    belief = run(COV)
    return np.stack(belief.moments().mean), belief


def jacobian(surge, sway):
    """Of the rates, by hand."""
    return np.array(
        [
            [-0.6 * abs(surge) + 0.2 * sway, 0.2 * surge],
            [-0.2 * surge, -1.0 * abs(sway)],
        ]
    )


weigh = quick_jit(memberships)


def test_memberships_sum_to_one_everywhere():
    lower, upper = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 0.5, 7.0])
    random = np.random.default_rng(0).uniform(-3, 9, (200, 3))
    found = quick_jit(jax.vmap(memberships, (0, None, None)))(random, lower, upper)
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-14)
    assert (np.asarray(found) >= 0).all()


def test_memberships_interpolate_what_is_affine_in_each_variable():
    """At a corner one rule counts; between, products of variables come out exactly."""
    lower, upper = np.array([-1.0, 0.5]), np.array([2.0, 1.5])
    ends = np.where(corners(2), upper, lower)
    for i, end in enumerate(ends):
        np.testing.assert_array_equal(weigh(end, lower, upper), np.eye(4)[i])
    at = np.array([0.3, 0.7])
    found = weigh(at, lower, upper) @ (3 + 2 * ends[:, 0] - ends[:, 0] * ends[:, 1])
    np.testing.assert_allclose(found, 3 + 2 * at[0] - at[0] * at[1], rtol=1e-14)


def test_falling_and_rising_memberships():
    """Errata of equations 52 and 53: at the lower end the falling one is 1."""
    lower, upper = np.array([0.0]), np.array([1.5])
    np.testing.assert_allclose(weigh(np.array([0.3]), lower, upper), [0.8, 0.2])
    np.testing.assert_array_equal(weigh(np.array([9.0]), lower, upper), [0, 1])
    np.testing.assert_array_equal(weigh(np.array([-9.0]), lower, upper), [1, 0])


def test_without_a_box_it_is_the_extended_filter(key):
    vehicle, sensor = vehicles.make("unicycle"), sensors.make("landmarks").for_target(0)
    prior = Gaussian(vehicle.start(), 0.1 * jnp.eye(3))
    seen = jax.tree.map(lambda leaf: leaf + 0.1, sensor.expect(vehicle.start()))

    @quick_jit
    def both(prior):
        found = []
        for filter in (FuzzyKalman(), ExtendedKalman()):
            belief = filter.init(prior, key)
            for _ in range(2):
                belief = filter.predict(vehicle, belief, vehicle.nominal_control(0.0), 0.4, key)
                belief, score = filter.update(sensor, belief, seen, key)
            found.append((belief.moments(), score))
        return found

    one, other = both(prior)
    for a, b in zip(*map(jax.tree.leaves, (one, other)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-13)


def test_on_a_linear_model_a_box_changes_nothing(key):
    prior = Gaussian(
        Moving(jnp.zeros(2), jnp.array([0.4, -0.2])), jnp.diag(jnp.array([1.0, 2, 0.3, 0.4]))
    )
    boxed = made(box={"velocity_x": (0.1, 0.5), "velocity_y": (-1.0, 0.0)})

    @quick_jit
    def both(prior):
        found = []
        for filter in (boxed, Kalman()):
            belief = filter.init(prior, key)
            for place in ([0.3, -0.4], [0.9, -0.2]):
                belief = filter.predict(ConstantVelocity(), belief, Nobody(), 0.5, key)
                belief, score = filter.update(
                    Gnss(), belief, Measurement(jnp.array(place)), key
                )
            found.append((belief.moments(), score))
        return found

    one, other = both(prior)
    for a, b in zip(*map(jax.tree.leaves, (one, other)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-13)


def test_a_rule_is_the_linearisation_at_its_corner():
    _, belief = predicted(box=ONE_SIGNED)
    noise = np.diag(np.array([0.1, 0.2]) ** 2 * DT)
    for i, corner in enumerate(np.where(corners(2), [1.5, 1.0], [0.0, 0.0])):
        F = np.eye(2) + DT * jacobian(*corner)
        np.testing.assert_allclose(
            belief.components.cov[i], F @ COV @ F.T + noise, rtol=1e-12, atol=1e-15
        )


def test_one_side_of_zero_the_published_predictor_is_that_of_one_rule():
    """The Jacobian of a quadratic model is affine, so its corners interpolate it exactly."""
    fuzzy, belief = predicted(box=ONE_SIGNED, predictor="jx")
    single, _ = predicted(predictor="jx")
    np.testing.assert_allclose(fuzzy, single, rtol=1e-13)
    by_hand = AT + DT * (jacobian(*AT) @ AT + np.array([0.4, 0.0]))
    np.testing.assert_allclose(single, by_hand, rtol=1e-13)
    # The rules differ, and their covariances are, in the mean, at least that of one rule.
    assert np.ptp(np.asarray(belief.components.mean.surge)) > 0.01
    F = np.eye(2) + DT * jacobian(*AT)
    noise = np.diag(np.array([0.1, 0.2]) ** 2 * DT)
    mean = np.tensordot(np.exp(belief.log_weights), belief.components.cov, 1)
    excess = mean - (F @ COV @ F.T + noise)
    assert np.linalg.eigvalsh(excess).min() > 0
    assert np.linalg.norm(excess) < 0.02 * np.linalg.norm(mean)


def test_across_zero_it_is_not():
    fuzzy, _ = predicted(box=ACROSS, predictor="jx")
    single, _ = predicted(predictor="jx")
    assert np.abs(fuzzy - single).max() > 0.02


def test_the_affine_predictor_is_the_model_itself():
    found, _ = predicted(box=ONE_SIGNED)
    u, v = AT
    rates = [-0.3 * u * u + 0.2 * u * v + 0.4, -0.5 * v * v - 0.1 * u * u]
    np.testing.assert_allclose(found, AT + DT * np.array(rates), rtol=1e-13)


def test_the_literal_covariance_forgets():
    _, belief = predicted(covariance="literal")
    C = DT * jacobian(*AT)
    noise = np.diag(np.array([0.1, 0.2]) ** 2 * DT)
    np.testing.assert_allclose(
        belief.components.cov[0], C @ COV @ C.T + noise, rtol=1e-12, atol=1e-15
    )


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"box": {"surge": (1.0, 0.5)}}, "'surge' is 1 to 0.5; the upper end must be above"),
        ({"box": {"surge": (1.0, 1.0)}}, "'surge' is 1 to 1; the upper end must be above"),
        ({"box": {"surge": (0.0, np.inf)}}, "'surge' is 0 to inf, not finite"),
        ({"box": {"surge": 1.0}}, "expected a mapping"),
        ({"box": "surge:0-1"}, "the side 'surge:0-1', expected NAME:LOWER..UPPER"),
        ({"box": "surge:0..1/surge:0..2"}, "box has 'surge' twice"),
        ({"predictor": "afine"}, r"predictor called 'afine' \(did you mean 'affine'"),
        ({"covariance": "joseph"}, "covariance called 'joseph'.*correct, literal"),
    ],
)
def test_bad_parameters(parameters, message):
    with pytest.raises(ContractError, match=message):
        FuzzyKalman(**parameters)


def test_a_component_that_the_state_has_not(key):
    prior = Gaussian(Ship().start(), jnp.asarray(COV))
    with pytest.raises(ContractError, match=r"'surg' \(did you mean 'surge'\?\).*surge, sway"):
        FuzzyKalman(box={"surg": (0, 1)}).init(prior, key)
    flying = vehicles.make("strapdown").start()
    with pytest.raises(ContractError, match="component of a rotation"):
        FuzzyKalman(box={"attitude_x": (0, 1)}).init(Gaussian(flying, jnp.eye(1)), key)


def test_a_box_across_zero_warns():
    """Once, with every side that does."""
    sides = {"surge": (-1.0, 2.0), "sway": (0.0, 1.0), "yaw_rate": (-0.5, 0.5)}
    message = "straddles zero in surge -1 to 2, yaw_rate -0.5 to 0.5: where"
    with pytest.warns(UserWarning, match=message) as caught:
        FuzzyKalman(box=sides)
    assert len(caught) == 1


def test_a_box_as_a_word_is_the_box_as_a_mapping():
    word = filters.make("fuzzy", box="surge:0..1.5/sway:0..1")
    assert word == FuzzyKalman(box=ONE_SIGNED)


def test_a_step_is_straight_line(key):
    filter, sensor = made(box={"velocity_x": (0.1, 2.0)}), Gnss()
    vehicle = ConstantVelocity()
    prior = Gaussian(jax.tree.map(jnp.asarray, vehicle.start()), jnp.eye(4))

    def step(prior):
        belief = filter.predict(vehicle, filter.init(prior, key), Nobody(), 0.5, key)
        return filter.update(sensor, belief, Measurement(jnp.ones(2)), key)

    program = str(jax.make_jaxpr(step)(prior))
    for crooked in ("while[", "scan[", "random", "eigh", "svd", "sort[", "cholesky"):
        assert crooked not in program
