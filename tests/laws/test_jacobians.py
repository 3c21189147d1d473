"""Automatic derivatives against central differences, for every shipped model (law 10)."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core import registry
from kedge.core.manifolds import space, space_of
from kedge.testing import quick_jit
from kedge.vehicles.augmented import Wander, augment

STEP = 1e-5
POINTS = 8


def both(function, size):
    """The Jacobian at the origin, and by central differences."""
    shifts = STEP * jnp.concatenate([jnp.eye(size), -jnp.eye(size)])
    ends = jax.vmap(function)(shifts)
    slopes = (ends[:size] - ends[size:]) / (2 * STEP)
    return jax.jacfwd(function)(jnp.zeros(size)), slopes.T


def vehicle_called(name):
    if name == "augmented":
        slow = {"speed_scale": Wander(0.1), "yaw_rate_scale": Wander(0.1, time_constant=5.0)}
        return augment(registry.vehicles.make("unicycle"), slow, ())
    return registry.vehicles.make(name)


@pytest.mark.parametrize("name", [*registry.vehicles.names(), "augmented"])
def test_vehicle(name):
    vehicle = vehicle_called(name)
    states, noises = space(vehicle.start()), space(vehicle.noise_density())

    @quick_jit
    @jax.vmap
    def slopes(white, time):
        state = states.boxplus(vehicle.start(), white)
        control = vehicle.drive(time)
        base = vehicle.step(state, control, noises.unflatten(noises.zeros()), 0.1)

        def end(shift):
            error, noise = shift[: states.size], shift[states.size :]
            begun = states.boxplus(state, error)
            return states.boxminus(
                vehicle.step(begun, control, noises.unflatten(noise), 0.1), base
            )

        return both(end, states.size + noises.size)

    exact, close = slopes(
        jr.normal(jr.key(0), (POINTS, states.size)), jnp.linspace(0, 20, POINTS)
    )
    np.testing.assert_allclose(exact, close, atol=1e-6 * max(1.0, np.abs(close).max()))


@pytest.mark.parametrize("name", registry.sensors.names())
def test_sensor(name):
    sensor = registry.sensors.make(name)
    reads, outputs = space_of(sensor.reads), space_of(sensor.measures)
    origin = reads.complete(reads.cls(*(jnp.full(c.shape, jnp.nan) for c in reads.charts)))[0]

    @quick_jit
    @jax.vmap
    def slopes(white):
        facing = sensor.facing(0)
        state = reads.boxplus(origin, white)
        base = facing.observe(state)

        def output(error):
            return outputs.boxminus(facing.observe(reads.boxplus(state, error)), base)

        return both(output, reads.size)

    exact, close = slopes(jr.normal(jr.key(0), (POINTS, reads.size)))
    np.testing.assert_allclose(exact, close, atol=1e-6 * max(1.0, np.abs(close).max()))
