"""The IMU of a simulated vehicle: what it reads integrates back to the route."""

import jax
import jax.numpy as jnp
import numpy as np

from kedge.core.registry import vehicles
from kedge.simulation.routes import FigureOfEight
from kedge.simulation.worlds.measured_vehicle import MeasuredVehicle
from kedge.testing import quick_jit
from kedge.vehicles.strapdown import Imu, State


def test_perfect_readings_integrate_back_to_the_route():
    """The zero test: 40 s of a figure of eight at 100 Hz, curves, speeds and all."""
    world, dt, steps = MeasuredVehicle(FigureOfEight()), 0.01, 4000
    vehicle, calm = vehicles.make("strapdown"), Imu(jnp.zeros(3), jnp.zeros(3))

    @quick_jit
    def run():
        motion = world.motion(jnp.arange(steps + 1) * dt)
        readings = world.readings(*motion, dt)

        def body(state, told):
            after = vehicle.step(state, told, calm, dt)
            return after, after

        first = State(*(leaf[0] for leaf in motion))
        return motion, jax.lax.scan(body, first, readings)[1]

    (position, velocity, attitude), found = run()
    assert np.abs(found.position - position[1:]).max() < 1e-4
    assert np.abs(found.velocity - velocity[1:]).max() < 1e-7
    same = np.abs(np.sum(np.asarray(found.attitude) * np.asarray(attitude[1:]), axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-12)
