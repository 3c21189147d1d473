"""What wheels tell a vehicle in space."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from kedge.estimation.rig import Installation, Mount
from kedge.sensors.odometer import Odometer
from kedge.sensors.rolling import Rolling
from kedge.testing import quick_jit
from kedge.vehicles.strapdown import RatedState


def test_the_rear_axle_of_a_turning_vehicle_does_not_slide():
    """An IMU 1.2 m ahead of the axle swings sideways by rate x arm; the axle does not."""
    rate, arm, speed = 0.5, 1.2, 2.0
    turn = Rotation.from_euler("ZYX", [0.7, 0.1, -0.2])
    inside = np.array([speed, rate * arm, 0.0])
    state = RatedState(
        jnp.zeros(3),
        jnp.asarray(turn.apply(inside)),
        jnp.asarray(np.roll(turn.as_quat(), 1)),
        jnp.array([0.0, 0.0, rate]),
    )
    axle = Mount(x=-arm)

    @quick_jit
    def look(state):
        wheels, speedometer = (
            Installation(name, sensor, mount=axle).expect(state, jnp.asarray(0))
            for name, sensor in (("wheels", Rolling()), ("odometer", Odometer()))
        )
        return wheels, speedometer

    wheels, speedometer = look(state)
    np.testing.assert_allclose([wheels.lateral, wheels.vertical], 0.0, atol=1e-12)
    np.testing.assert_allclose(speedometer.speed, speed, rtol=1e-12)
