"""Published forms of the Kalman filter, raw readings, and fields that are carried along."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import Acceleration, Metres, Speed
from kedge.estimation.log import Readings
from kedge.estimation.reading import bind_reading
from kedge.estimation.rig import Installation
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.published.linearised import LinearisedKalman
from kedge.filters.published.raw import Raw
from kedge.filters.wrappers.carried import Carried
from kedge.sensors.gnss import Gnss
from kedge.sensors.gnss import Measurement as Fix
from kedge.vehicles.constant_velocity import ConstantVelocity
from kedge.vehicles.constant_velocity import Control as NoControl

FIELDS = ("place",)


class State(NamedTuple):
    place: Metres
    speed: Speed


class Push(NamedTuple):
    acceleration: Acceleration


class Boat(AbstractVehicle[State, Push, Push]):
    """Drag by the square of the speed; Euler's rule."""

    def step(self, state, control, noise, dt):
        push = control.acceleration + noise.acceleration
        change = push - 0.5 * state.speed * abs(state.speed)
        return State(state.place + dt * state.speed, state.speed + dt * change)

    def noise_density(self):
        return Push(jnp.asarray(0.1))

    def start(self):
        return State(jnp.asarray(3.0), jnp.asarray(1.6))

    def nominal_control(self, time):
        return Push(jnp.asarray(0.7))


class Spoken(NamedTuple):
    speed: Speed


class Log(AbstractSensor[Spoken]):
    """Measures the speed."""

    reads = Spoken
    measures = Spoken

    def observe(self, state):
        return self.measures(state.speed)

    def noise_std(self, state):
        return self.measures(jnp.asarray(0.1))


PRIOR = Gaussian(Boat().start(), jnp.eye(2) * 1e-4)
PUSH = Boat().nominal_control(0.0)


def predicted(filter, key, steps=1):
    belief = filter.init(PRIOR, key)
    for _ in range(steps):
        belief = filter.predict(Boat(), belief, PUSH, 0.1, key)
    return belief


def test_jx_counts_forces_of_second_degree_twice(key):
    """Euler's theorem: J x = 2 f for drag; the control counts once."""
    for carried in ((), FIELDS):
        once, twice = (
            predicted(Carried(LinearisedKalman(predictor=p), carried), key).moments().mean
            for p in ("affine", "jx")
        )
        drag = 0.1 * 0.5 * 1.6**2
        np.testing.assert_allclose(once.speed, 1.6 + 0.07 - drag)
        np.testing.assert_allclose(twice.speed, 1.6 + 0.07 - 2 * drag)
        np.testing.assert_allclose([once.place, twice.place], 3.16)


def test_the_affine_form_is_the_extended_filter(key):
    one, other = (predicted(f, key, 2) for f in (LinearisedKalman(), ExtendedKalman()))
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


def test_covariances(key):
    """F = [1 h; 0 1 - h c u] by hand, and what the printed form makes of it."""
    F, Q = np.array([[1, 0.1], [0, 1 - 0.16]]), np.diag([0.0, 0.1 * 0.1**2])
    correct = predicted(LinearisedKalman(), key).cov
    np.testing.assert_allclose(correct, 1e-4 * F @ F.T + Q, rtol=1e-12)
    C = F - np.eye(2)
    literal = predicted(LinearisedKalman(covariance="literal"), key).cov
    np.testing.assert_allclose(literal, 1e-4 * C @ C.T + Q, rtol=1e-12)


def test_a_model_frozen_at_the_start_does_not_follow(key):
    frozen = predicted(LinearisedKalman(point="start", predictor="jx"), key, 20)
    speed = 1.6
    for _ in range(20):
        speed = (1 - 0.16) * speed + 0.07
    np.testing.assert_allclose(frozen.mean.speed, speed)
    affine = predicted(LinearisedKalman(point="start"), key, 1)
    np.testing.assert_allclose(affine.mean.speed, 1.6 + 0.07 - 0.128)


def test_options_that_are_unknown():
    with pytest.raises(ContractError, match="no predictor called 'jy'"):
        LinearisedKalman(predictor="jy")


def test_raw_readings_replace_what_is_believed(key):
    vehicle = ConstantVelocity()
    prior = Gaussian(vehicle.start(), jnp.eye(4) * 0.01)
    model, reading = bind_reading(
        Installation("gnss", Gnss(std=2.0)),
        Readings(Fix(jnp.array([7.0, jnp.nan])), jnp.asarray(-1), None),
    )
    belief, score = Raw().update(model, Raw().init(prior, key), reading, key)
    np.testing.assert_allclose(belief.mean.position, [7.0, prior.mean.position[1]])
    np.testing.assert_allclose(belief.mean.velocity, prior.mean.velocity)
    np.testing.assert_allclose(jnp.diag(belief.cov), [4.0, 0.01, 0.01, 0.01])
    expected = 7.0**2 / (4.0 + 0.01)
    assert float(score.nis) == pytest.approx(expected)
    after = Raw().predict(vehicle, belief, NoControl(), 1.0, key)
    np.testing.assert_allclose(after.mean.position[0], 7.0 + prior.mean.velocity[0])


def test_what_is_carried_is_integrated_from_the_mean(key):
    """Whatever the filter of the rest: no reading and no member moves it."""
    for inner in (ExtendedKalman(), EnsembleKalman(count=8)):
        filter = Carried(inner, FIELDS)
        belief = filter.init(PRIOR, key)
        before = belief.moments().mean
        belief = filter.predict(Boat(), belief, PUSH, 0.1, key)
        belief, _ = filter.update(Log(), belief, Log().observe(before), key)
        found = belief.moments()
        np.testing.assert_allclose(found.mean.place, before.place + 0.1 * before.speed)
        assert not found.cov[0].any()
        assert 0 < found.cov[1, 1] < 2e-3
        assert belief.inflated(4.0).moments().cov[1, 1] == pytest.approx(4 * found.cov[1, 1])


def test_fields_that_cannot_be_carried(key):
    with pytest.raises(ContractError, match="no field of the state called 'depth'"):
        Carried(ExtendedKalman(), ("depth",)).init(PRIOR, key)
    with pytest.raises(ContractError, match="the whole state"):
        Carried(ExtendedKalman(), State._fields).init(PRIOR, key)
