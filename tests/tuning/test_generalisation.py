"""Leaving one log out: what is tuned on few readings does not hold where there are others."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.tuning.evaluator import Case, Evaluator
from kedge.tuning.generalisation import LeftOut, generalisation, leave_one_out
from kedge.tuning.tunable import choose
from kedge.tuning.tuning import Search, conclude, fit
from kedge.vehicles.constant_velocity import ConstantVelocity


def buoy(noise=0.3, std=0.5):
    vehicle = ConstantVelocity(acceleration_noise=noise)
    sensor = Installation("gnss", Gnss(std=std), rate=2.0)
    return Rig(vehicle, (sensor,), Gaussian(vehicle.start(), 0.1 * jnp.eye(4)))


def left_out(duration, count, start, names=None):
    cases = [
        Case(start, record(Scenario(buoy(), duration, 0.5), jr.key(seed), 2.0)[0])
        for seed in range(count)
    ]
    chosen, search = choose(start, names), Search(starts=1)
    whole = fit(ExtendedKalman(), cases, chosen, search)
    values = conclude(whole).values
    without = [cases[:n] + cases[n + 1 :] for n in range(count)]
    parts = leave_one_out(ExtendedKalman(), without, whole, values, search)
    return cases, chosen, values, parts


def test_losses_of_parts_are_those_of_their_logs_alone():
    cases, chosen, values, parts = left_out(20.0, 2, buoy(0.5, 0.4))
    for case, part in zip(cases, parts, strict=True):
        alone = Evaluator(ExtendedKalman(), [case], tuple(chosen), np.full(2, 9.0))
        start = [t.value for t in chosen]
        for loss, at in zip(part[2:], (start, values, part.values), strict=True):
            own = alone(alone.coordinates(at))
            assert loss == pytest.approx(own.total / own.judged, rel=1e-9)
        assert part.judged == 40
    # What is found on the one is the other's, and no part was tuned on itself.
    assert not np.allclose(parts[0].values, parts[1].values, rtol=1e-3)
    whole = generalisation(parts, chosen, "logs")
    assert whole.tuned_on <= min(whole.start, whole.left_out)


def test_many_readings_and_few_numbers_hold():
    _, chosen, _, parts = left_out(100.0, 3, buoy(3.0, 0.05))
    verdict = generalisation(parts, chosen, "logs")
    assert verdict.status == "holds"
    assert verdict.left_out - verdict.tuned_on < 0.05
    assert "600 judgements of 3 logs" in verdict.sentence


def test_few_readings_and_as_many_numbers_are_said_to_be_over_fit():
    start = buoy(3.0, 0.05)
    _, chosen, _, parts = left_out(2.0, 3, start)
    verdict = generalisation(parts, chosen, "logs")
    assert verdict.status == "over-fit"
    assert "2 numbers tuned on 12 judgements of 3 logs" in verdict.sentence
    assert "tune fewer" in verdict.sentence


def test_values_that_are_worse_than_the_rigs_are_said_to_be():
    _, chosen, _, parts = left_out(2.0, 3, buoy())
    verdict = generalisation(parts, chosen, "logs")
    assert verdict.status == "worse"
    assert "keep the rig's" in verdict.sentence


@pytest.mark.parametrize(
    ("certainty", "status"),
    [(None, "holds"), (1.5, "holds"), (1.7, "too sure"), (np.nan, "too sure")],
)
def test_readings_foretold_are_not_enough_where_the_truth_is_missed(certainty, status):
    part = LeftOut(np.ones(2), 10, 5.0, 1.0, 1.01)
    verdict = generalisation([part, part], choose(buoy(), None), "logs", certainty)
    assert verdict.status == status
    assert verdict.sentence.startswith(status)


@pytest.mark.parametrize(("growth", "status"), [(1.05, "holds"), (1.2, "farther off")])
def test_readings_foretold_are_not_enough_where_the_error_grows(growth, status):
    part = LeftOut(np.ones(2), 10, 5.0, 1.0, 1.01)
    verdict = generalisation([part, part], choose(buoy(), None), "logs", 1.0, growth)
    assert verdict.status == status


def test_parts_count_by_their_judgements():
    chosen = choose(buoy(), None)
    parts = [LeftOut(np.ones(2), 1, 5.0, 1.0, 2.0), LeftOut(np.ones(2), 3, 1.0, 1.0, 1.0)]
    verdict = generalisation(parts, chosen, "blocks")
    assert (verdict.start, verdict.tuned_on, verdict.left_out) == (2.0, 1.0, 1.25)
