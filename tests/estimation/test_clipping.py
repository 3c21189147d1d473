"""What a log tells the fins beyond what they can is counted: it acts as what they can."""

import numpy as np
import pytest

from kedge.estimation.clipping import clipped, sentences
from kedge.estimation.log import SECOND, assemble
from kedge.vehicles.augmented import Augmented
from kedge.vehicles.constant_velocity import ConstantVelocity
from kedge.vehicles.underwater import Control, Underwater


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


def test_rounding_is_not_beyond():
    """A log in degrees has 13.6, which is 0.23736 rad and a little."""
    assert clipped(recording(np.full(10, np.radians(13.6))), Underwater()) == {}


def test_slow_states_change_no_limit_and_most_vehicles_have_none():
    told = recording(np.full(10, 1.0))
    augmented = Augmented(Underwater(), {}, ())
    assert clipped(told, augmented) == clipped(told, Underwater()) != {}
    assert clipped(told, ConstantVelocity()) == {}
