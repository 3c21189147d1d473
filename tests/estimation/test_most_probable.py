"""The most probable trajectory against least squares over the start and all noise."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space
from kedge.core.registry import filters
from kedge.estimation.most_probable import most_probable
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.smoother import smooth
from kedge.numerics.losses import Loss
from kedge.sensors.gnss import Gnss
from kedge.sensors.ranges import Ranges
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.vehicles.constant_velocity import ConstantVelocity

ANCHORS = jnp.array([[4.0, 0.0], [-3.0, 3.0], [0.0, -5.0]])
SECONDS, RATE = 6.0, 2.0


def rig_of(robust=None):
    """Ranges from nearby, which bend within what is believed."""
    vehicle = ConstantVelocity(acceleration_noise=0.4)
    sensor = Ranges(range_std=0.3)
    target = type(sensor.target)(position=ANCHORS)
    sensor = dataclasses.replace(sensor, target=target)
    installed = Installation("radio", sensor, rate=RATE, robust=robust)
    return Rig(vehicle, (installed,), Gaussian(vehicle.start(), 1.5 * jnp.eye(4)))


def least(rig, log):
    """Positions at the readings that minimise the sum of squares, from the models alone."""
    states, noises = space(rig.prior.mean), space(rig.vehicle.noise_density())
    density = noises.flatten(rig.vehicle.noise_density())
    control = rig.vehicle.nominal_control(0.0)
    times = np.asarray(log.schedule.time)
    rows, (installed,) = log.readings[0], rig.sensors
    root = jnp.linalg.cholesky(rig.prior.cov)

    def residuals(unknown):
        drawn = unknown[:4]
        state = states.boxplus(rig.prior.mean, root @ drawn)
        whitened, at, before, used = [drawn], [], 0.0, 4
        for time, sensor, row in zip(times, *map(np.asarray, log.schedule[1:]), strict=True):
            if (dt := time - before) > 0:
                noise = unknown[used : used + 2]
                used, before = used + 2, time
                scaled = noises.unflatten(noise * density / np.sqrt(dt))
                state = rig.vehicle.step(state, control, scaled, dt)
                whitened.append(noise)
            at.append(states.flatten(state))
            if sensor >= 0:
                target = rows.target[row]
                seen = installed.expect(state, target).range - rows.measurement.range[row]
                scale = jnp.sqrt(installed.noise_cov(state, target)[0, 0])
                distance = jnp.abs(seen / scale) + 1e-12
                if installed.robust is not None:
                    cost = installed.robust.cost(distance[None], jnp.eye(1), 1)
                    distance = jnp.sqrt(cost)
                whitened.append(distance[None])
        return jnp.concatenate(whitened), jnp.stack(at)

    count = 4 + 2 * len(np.unique(times[times > 0]))
    slope = jax.jit(jax.jacfwd(lambda u: residuals(u)[0]))
    both = jax.jit(residuals)
    solved = least_squares(
        lambda u: np.asarray(both(u)[0]), np.zeros(count), lambda u: np.asarray(slope(u)),
        xtol=1e-14, ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    return np.asarray(both(solved.x)[1]), 2 * solved.cost


@pytest.mark.parametrize("robust", [None, Loss("student", 4.0), Loss("cauchy", 1.0)])
def test_it_is_the_least_sum_of_squares(robust):
    rig = rig_of(robust)
    recording, _ = record(Scenario(rig, SECONDS, 0.5), jax.random.key(5), output_rate=RATE)
    reading = recording.log.readings[0]
    if robust is not None:  # a detour
        longer = reading.measurement.range.at[5].add(4.0)
        reading = reading._replace(measurement=reading.measurement._replace(range=longer))
    log = recording.log._replace(readings=(reading,))
    found = most_probable(filters.make("extended"), rig, log)
    states, cost = least(rig, log)
    mean = np.asarray(jax.vmap(space(rig.prior.mean).flatten)(found.estimates.moments.mean))
    np.testing.assert_allclose(found.costs[-1], cost, rtol=1e-6)
    np.testing.assert_allclose(mean, states, atol=2e-3 if robust else 2e-4)
    assert np.all(np.diff(found.costs) <= 1e-9)
    assert found.costs[0] - found.costs[-1] > 1e-3  # the smoothed trajectory was not it


def test_on_a_linear_model_it_is_the_smoother():
    vehicle = ConstantVelocity(acceleration_noise=0.4)
    fixes = (Installation("gnss", Gnss(std=0.3), rate=RATE),)
    rig = Rig(vehicle, fixes, Gaussian(vehicle.start(), jnp.eye(4)))
    recording, _ = record(Scenario(rig, SECONDS, 0.5), jax.random.key(1), output_rate=RATE)
    for name in ("kalman", "cubature"):
        _, smoothed = smooth(filters.make(name), rig, recording)
        found = most_probable(filters.make(name), rig, recording).estimates.moments
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b, atol=1e-9), found, smoothed.moments
        )
