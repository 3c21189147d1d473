"""A guided point: on its route without gusts, as far from it with them as theory says."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from kedge.core.beliefs import Gaussian
from kedge.estimation.rig import Rig
from kedge.simulation.routes import Rectangle
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import simulate
from kedge.simulation.worlds.guided_point import GuidedPoint
from kedge.vehicles.constant_velocity import ConstantVelocity

DT, GUST = 0.1, 0.1


def deviations(gust, keys):
    """From the route, of position (m); leading axes of runs and steps."""
    vehicle = ConstantVelocity()
    rig = Rig(vehicle, (), Gaussian(vehicle.start(), jnp.eye(4)))
    scenario = Scenario(rig, 100.0, DT, world=GuidedPoint(Rectangle(), gust))
    truth = jax.vmap(lambda key: simulate(scenario, key).truth)(keys)
    route = jax.vmap(Rectangle().at)(jnp.arange(1, 1001) * DT)
    return np.asarray(truth.position - route.position[None])


def test_without_gusts_it_is_on_its_route():
    assert abs(deviations(0.0, jr.split(jr.key(0), 1))).max() < 1e-12


def test_gusts_blow_it_as_far_as_the_lyapunov_equation_says():
    """0.019 m by axis: the stationary covariance of the error under its guidance."""
    F, G = np.array([[1, DT], [0, 1]]), np.array([[DT**2 / 2], [DT]])
    led = F - G @ np.array([[1.0, 1.4]])
    expected = np.sqrt(solve_discrete_lyapunov(led, GUST**2 * G @ G.T)[0, 0])
    assert round(expected, 3) == 0.019
    found = deviations(GUST, jr.split(jr.key(0), 50))[:, 200:]
    # About 2,000 independent values: one sample every 4 s, two axes, 50 runs.
    assert abs(np.std(found) / expected - 1) < 5 / np.sqrt(2 * 2000)
