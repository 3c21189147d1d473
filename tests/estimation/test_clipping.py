"""What a log tells the fins beyond what they can is counted: it acts as what they can."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.clipping import clipped, sentences
from kedge.estimation.log import SECOND, assemble
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.vehicles.augmented import Augmented
from kedge.vehicles.constant_velocity import ConstantVelocity
from kedge.vehicles.underwater.underwater import Control, Underwater
from kedge.vehicles.unicycle import Unicycle


def recording(rudder):
    """A command each second, 10 s of them, with estimates in between."""
    stamps, none = SECOND * np.arange(10), np.zeros(10)
    controls = Control(none + 99.0, none, np.asarray(rudder, float), none)
    return assemble(0, 10 * SECOND, stamps, controls, [], output_rate=4.0)


def test_what_is_beyond_is_counted():
    limit = Underwater().hull.fin_limit
    told = recording([0.0, 0.3, 0.3, -0.5, 0.0, 0.0, limit, -limit, 0.25, 0.1])
    found = clipped(told, Underwater())
    assert found == {
        "rudder": {
            "limit": limit,
            "commands": 3,  # 0.3, -0.5 and 0.25
            "seconds": pytest.approx(4.0),
            "largest": 0.5,
        }
    }
    (said,) = sentences(found)
    assert said == (
        "control: rudder was told 3 times to be beyond its limit of 0.237 (up to 0.5), for "
        "4.0 s in all; it acts as the limit"
    )


class Limited(Unicycle):
    """Drives no faster than 2 m/s."""

    def control_limits(self):
        return self.nominal_control(0.0)._replace(speed=2.0, yaw_rate=np.inf)


def test_live_commands_are_counted_too():
    vehicle = Limited()
    prior = Gaussian(vehicle.start(), 0.1 * jnp.eye(3))
    estimator = Estimator(ExtendedKalman(), Rig(vehicle, (), prior))
    for time, speed in ((0.1, 1.0), (0.2, 3.0), (0.3, -2.5), (0.3, -2.5), (0.2, 9.0)):
        told = vehicle.nominal_control(0.0)._replace(speed=speed, yaw_rate=7.0)
        estimator.push(time, control=told)
    assert estimator.clipped == {"speed": 2}  # neither what comes twice nor what is late


def test_rounding_is_not_beyond():
    """A log in degrees has 13.6, which is 0.23736 rad and a little."""
    assert clipped(recording(np.full(10, np.radians(13.6))), Underwater()) == {}


def test_slow_states_change_no_limit_and_most_vehicles_have_none():
    told = recording(np.full(10, 1.0))
    augmented = Augmented(Underwater(), {}, ())
    assert clipped(told, augmented) == clipped(told, Underwater()) != {}
    assert clipped(told, ConstantVelocity()) == {}
