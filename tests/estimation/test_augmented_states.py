"""A wheel scale and a camera's bias are found along the way."""

import jax
import jax.numpy as jnp
import numpy as np

from kedge.core.beliefs import Gaussian
from kedge.estimation.batch import estimate
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.landmarks import Landmarks
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.testing import quick_jit
from kedge.vehicles.augmented import Drift, augment
from kedge.vehicles.unicycle import Unicycle


def test_slow_quantities_are_found():
    """The truth has a scale of 1.1 and a bias of .05 rad; the filter starts from 1 and 0."""
    camera = Landmarks()
    slow = {"speed_scale": Drift(), "bearing_bias": Drift()}
    vehicle = augment(Unicycle(speed_noise=0.05), slow, (camera,))
    sensors = (Installation("camera", camera),)
    real = vehicle.start()._replace(speed_scale=jnp.array(1.1), bearing_bias=jnp.array(0.05))
    world = Rig(vehicle, sensors, Gaussian(real, jnp.zeros((5, 5))))
    recording, truth = record(
        Scenario(world, duration=20.0), jax.random.key(4), output_rate=1.0
    )
    np.testing.assert_allclose(truth.fields["speed_scale"], 1.1)

    unsure = jnp.diag(jnp.array([0.01, 0.01, 0.01, 0.2, 0.1]) ** 2)
    rig = Rig(vehicle, sensors, Gaussian(vehicle.start(), unsure))
    run = quick_jit(
        lambda readings: estimate(
            ExtendedKalman(), rig, recording.log._replace(readings=readings)
        )
    )
    moments = run(recording.log.readings).moments

    assert (moments.mean.speed_scale[0], moments.mean.bearing_bias[0]) == (1.0, 0.0)
    errors = np.array(
        [moments.mean.speed_scale[-1] - 1.1, moments.mean.bearing_bias[-1] - 0.05]
    )
    std = np.sqrt(np.diag(moments.cov[-1])[3:])
    assert (np.abs(errors) < 3 * std).all()
    # From 20 % and 6 degrees: each is known at least ten times better.
    assert (std < [0.02, 0.01]).all()
