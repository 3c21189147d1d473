"""Against FilterPy's unscented filter, as it is and with the points as they were propagated."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge import filters
from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Range, Velocity
from kedge.estimation.log import Log, Readings, Schedule

STD = 0.2
NOISE = 0.3
PARAMETERS = {"alpha": 0.5, "beta": 2.0, "kappa": 0.0}


class State(NamedTuple):
    velocity: Velocity


class Measurement(NamedTuple):
    range: Range


class Pendulum(kedge.AbstractVehicle):
    r"""$x' = x + \Delta t\,(y, -\sin x) + w \Delta t$."""

    def step(self, state, control, noise, dt):
        x, y = state.velocity
        rates = jnp.stack([y, -9.8 * jnp.sin(x)]) + noise.velocity
        return State(state.velocity + dt * rates)

    def noise_density(self):
        return State(jnp.full(2, NOISE))

    def start(self):
        return State(jnp.array([1.5, 0.0]))

    def nominal_control(self, time):
        return ()


class Sine(AbstractSensor):
    reads = State
    measures = Measurement

    def observe(self, state):
        return Measurement(jnp.sin(state.velocity[0]))

    def noise_std(self, state):
        return Measurement(STD)


@pytest.fixture(scope="module")
def problem():
    vehicle, count = Pendulum(), 30
    prior = kedge.Gaussian(vehicle.start(), jnp.diag(jnp.array([0.3, 0.2])))
    rig = kedge.Rig(vehicle, (kedge.Installation("sine", Sine()),), prior)
    z = np.random.default_rng(2).normal(np.sin(1.5 * np.cos(0.15 * np.arange(count))), STD)
    schedule = Schedule(
        0.05 * (1 + jnp.arange(count)), jnp.zeros(count, int), jnp.arange(count)
    )
    readings = Readings(Measurement(jnp.asarray(z)), jnp.zeros(count, int))
    return rig, Log(schedule, (), (readings,))


def textbook(rig, log, redraw):
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    filter = UnscentedKalmanFilter(
        dim_x=2, dim_z=1, dt=0.05,
        fx=lambda x, dt: x + dt * np.array([x[1], -9.8 * np.sin(x[0])]),
        hx=lambda x: np.sin(x[:1]),
        points=MerweScaledSigmaPoints(2, **PARAMETERS),
    )  # fmt: skip
    filter.x, filter.P = np.array(rig.prior.mean.velocity), np.array(rig.prior.cov)
    filter.Q, filter.R = np.eye(2) * NOISE**2 * 0.05, np.eye(1) * STD**2
    means, covs, likelihood = [], [], 0.0
    for value in np.asarray(log.readings[0].measurement.range):
        propagated = [
            filter.fx(x, 0.05) for x in filter.points_fn.sigma_points(filter.x, filter.P)
        ]
        filter.predict()
        if not redraw:
            filter.sigmas_f = np.array(propagated)
        filter.update(np.array([value]))
        means.append(filter.x.copy())
        covs.append(filter.P.copy())
        likelihood += filter.log_likelihood
    return np.array(means), np.array(covs), likelihood


@pytest.mark.parametrize("redraw", [False, True])
def test_its_figures_are_those_of_filterpy(problem, redraw):
    means, covs, likelihood = textbook(*problem, redraw)
    found = kedge.estimate(filters.AdditiveUnscented(**PARAMETERS, redraw=redraw), *problem)
    np.testing.assert_allclose(found.moments.mean.velocity, means, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.moments.cov, covs, rtol=1e-8)
    assert float(found.log_likelihood) == pytest.approx(likelihood, rel=1e-9)


def test_the_other_form_differs_from_them(problem):
    means, _, _ = textbook(*problem, redraw=True)
    found = kedge.estimate(filters.Unscented(**PARAMETERS), *problem)
    gap = np.abs(found.moments.mean.velocity - means).max() / np.abs(means).max()
    assert 1e-5 < gap < 0.1


def test_without_parameters_of_its_own_it_is_the_cubature_rule():
    rule = filters.AdditiveUnscented(kappa=0.0)._rule(3)
    assert rule.cov_weights[0] == 0
    np.testing.assert_allclose(rule.cov_weights[1:], 1 / 6)
