"""Sensors that fall silent for longer than allowed make the estimate degraded, not wrong."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.verdicts import Verdict
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.scores import Silence
from kedge.evaluation.silences import exceeded, sentences
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.gnss import Gnss, Measurement
from kedge.vehicles.constant_velocity import ConstantVelocity


@pytest.fixture(scope="module")
def rig():
    vehicle = ConstantVelocity()
    gnss = Installation("gnss", Gnss(), allowed_silence=2.0)
    other = Installation("spare", Gnss())
    return Rig(vehicle, (gnss, other), Gaussian(vehicle.start(), jnp.eye(4)))


def fix(*position):
    return Measurement(np.array(position))


def test_live(rig):
    """What is not fused does not count; what comes late and is fused does."""
    live = Estimator(ExtendedKalman(), rig, lag=3.0)
    live.push(1.0, "gnss", fix(0.0, 0.0))
    assert live.degraded == ()
    live.push(3.0, "spare", fix(0.0, 0.0))
    assert live.degraded == ()
    answer = live.push(3.5, "gnss", fix(np.nan, np.nan))
    assert answer.verdict == Verdict.NOT_FINITE
    assert live.degraded == ("gnss",)
    live.push(2.5, "gnss", fix(0.0, 0.0))
    assert live.degraded == ()
    live.push(5.0)
    assert live.degraded == ("gnss",)
    live.push(5.1, "gnss", fix(0.0, 0.0))
    assert live.degraded == ()


def test_stretches():
    heard = np.array([1.0, 2.0, 7.0, 7.5])
    assert exceeded(heard, 9.0, 2.0) == [(4.0, 7.0)]
    assert exceeded(heard, 12.5, 2.0) == [(4.0, 7.0), (9.5, 12.5)]
    assert exceeded(np.zeros(0), 3.0, 2.0) == [(2.0, 3.0)]
    assert exceeded(heard, 9.0, 5.0) == []


def test_it_is_said():
    found = {"dvl": Silence(2.0, ((4.0, 7.0),), 3.0)}
    (said,) = sentences("extended", found)
    assert said == (
        "extended: dvl was not heard for 5.0 s until 7.0 s, allowed are 2 s: the estimate is "
        "degraded from 4.0 s on until then."
    )
