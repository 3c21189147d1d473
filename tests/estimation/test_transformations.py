"""JAX's transformations go through the public functions: jit, grad, vmap."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge import filters, sensors, vehicles


@pytest.fixture(scope="module")
def scenario():
    vehicle = vehicles.Unicycle()
    prior = kedge.Gaussian(vehicle.start(), jnp.diag(jnp.array([0.5, 0.5, 0.1])))
    rig = kedge.Rig(vehicle, (kedge.Installation("gnss", sensors.Gnss(std=0.4)),), prior)
    return kedge.Scenario(rig, duration=6.0, dt=0.2)


@pytest.fixture(scope="module")
def recording(scenario):
    return kedge.record(scenario, jax.random.key(1), output_rate=1.0)[0]


def rig_with(rig, std, noise):
    sensor = dataclasses.replace(rig.sensors[0].sensor, std=std)
    installed = dataclasses.replace(rig.sensors[0], sensor=sensor)
    vehicle = dataclasses.replace(rig.vehicle, speed_noise=noise)
    return kedge.Rig(vehicle, (installed,), rig.prior)


def likelihood(rig, recording, point):
    std, noise = point
    found = kedge.estimate(filters.Extended(), rig_with(rig, std, noise), recording)
    return found.log_likelihood


def test_the_gradient_by_parameters_is_that_of_differences(scenario, recording):
    at, step = jnp.array([0.3, 0.15]), 1e-5

    def by(point):
        return likelihood(scenario.rig, recording, point)

    slopes = [(by(at + step * e) - by(at - step * e)) / (2 * step) for e in jnp.eye(2)]
    np.testing.assert_allclose(jax.grad(by)(at), slopes, rtol=1e-5)
    np.testing.assert_allclose(jax.jacfwd(by)(at), slopes, rtol=1e-5)


def test_within_jit_it_is_the_same(scenario, recording):
    point = jnp.array([0.3, 0.15])
    inside = eqx.filter_jit(likelihood)(scenario.rig, recording, point)
    outside = likelihood(scenario.rig, recording, point)
    assert float(inside) == pytest.approx(float(outside), rel=1e-12)


def test_mapped_over_parameters_it_is_each_by_itself(scenario, recording):
    points = jnp.array([[0.3, 0.15], [0.5, 0.1], [0.4, 0.3]])
    mapped = jax.vmap(lambda point: likelihood(scenario.rig, recording, point))(points)
    each = [likelihood(scenario.rig, recording, point) for point in points]
    np.testing.assert_allclose(mapped, each, rtol=1e-12)


def test_the_gradient_goes_through_the_smoother(scenario, recording):
    def last_error(noise):
        rig = rig_with(scenario.rig, jnp.array(0.4), noise)
        return kedge.smooth(filters.Extended(), rig, recording)[1].moments.mean.position[0, 0]

    at, step = jnp.array(0.2), 1e-5
    slope = (last_error(at + step) - last_error(at - step)) / (2 * step)
    assert float(jax.grad(last_error)(at)) == pytest.approx(float(slope), rel=1e-4)
    assert abs(float(slope)) > 1e-6


def test_simulation_is_mapped_over_keys(scenario):
    keys = jax.random.split(jax.random.key(5), 3)
    runs = jax.vmap(lambda key: kedge.simulate(scenario, key))(keys)
    assert runs.truth.position.shape == (3, 30, 2)
    one = kedge.simulate(scenario, keys[2])
    for mapped, alone in zip(jax.tree.leaves(runs), jax.tree.leaves(one), strict=True):
        np.testing.assert_allclose(mapped[2], alone, rtol=1e-12, atol=1e-12)
    assert np.ptp(runs.truth.heading[:, -1]) > 0


def test_simulation_and_estimation_are_one_program(scenario, recording):
    """Position errors of runs that are drawn, sensed and filtered inside one vmap."""
    from kedge.simulation import with_readings

    def squared_error(key):
        run = kedge.simulate(scenario, key)
        log = with_readings(recording.log, scenario, run)
        found = kedge.estimate(filters.Extended(), scenario.rig, log)
        return jnp.sum((found.moments.mean.position[-1] - run.truth.position[-1]) ** 2)

    errors = jax.jit(jax.vmap(squared_error))(jax.random.split(jax.random.key(6), 32))
    assert errors.shape == (32,)
    assert 0.01 < float(jnp.sqrt(errors.mean() / 2)) < 0.8  # of fixes with 0.4 m
