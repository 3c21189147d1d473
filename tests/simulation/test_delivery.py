"""Messages that are late or come twice: an estimator with a window hears the same of them."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from kedge.core.beliefs import Gaussian
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.position_velocity import PositionVelocity
from kedge.simulation.delivery import delivered
from kedge.simulation.fault_kinds import Dropout, Duplicate, OutOfOrder
from kedge.simulation.faults import Fault
from kedge.simulation.scenario import Scenario
from kedge.vehicles.constant_velocity import ConstantVelocity

CAR = ConstantVelocity()
SENSOR = Installation("gps", PositionVelocity(), rate=10.0)
RIG = Rig(CAR, (SENSOR,), Gaussian(CAR.start(), jnp.eye(4)))
GAP = Fault("gap", "gps", Dropout(), ((1.0, 1.5),))
PLAIN = Scenario(RIG, duration=4.0, dt=0.1, faults=(GAP,))
LATE = Fault("late", "gps", OutOfOrder(0.3, 0.2))
TWICE = Fault("twice", "gps", Duplicate(0.3, 0.05))


def heard(messages):
    estimator = Estimator(ExtendedKalman(), RIG, lag=10.0)
    verdicts = [
        estimator.push(m.time, m.sensor, m.measurement, target=m.target).verdict.name
        for m in messages
    ]
    return estimator.belief, verdicts


def test_late_and_double_messages_change_nothing_in_the_end(key):
    ordered = delivered(PLAIN, key)
    messy = delivered(dataclasses.replace(PLAIN, faults=(GAP, LATE, TWICE)), key)
    assert len(ordered) == 35  # of 40, without those of the gap
    times = np.array([m.time for m in messy])
    assert (np.diff(times) < 0).any()
    assert (np.diff([m.arrival for m in messy]) >= 0).all()
    assert all(m.arrival >= m.time for m in messy)
    assert {m.time for m in messy} == {m.time for m in ordered}

    calm, verdicts = heard(ordered)
    assert set(verdicts) == {"FUSED"}
    belief, verdicts = heard(messy)
    copies = len(messy) - len(ordered)
    assert copies > 3
    assert verdicts.count("DUPLICATE") == copies
    np.testing.assert_array_equal(belief.mean.position, calm.mean.position)
    np.testing.assert_array_equal(belief.cov, calm.cov)
