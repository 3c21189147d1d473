"""Readings predicted over horizons: against logs without them, differences, and truth."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy.signal import lfilter

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ConfigError, DataError
from kedge.estimation.batch import estimate
from kedge.estimation.correlated_error import CorrelatedError
from kedge.estimation.error_states import with_errors
from kedge.estimation.log import alike
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.score import score
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.wrappers.withholding import Withholding
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.tuning.evaluator import Case, Evaluator
from kedge.tuning.tunable import choose, placed, tunables
from kedge.tuning.tuning import Search, fit
from kedge.vehicles.constant_velocity import ConstantVelocity

HORIZONS = (1.0, 5.0, 20.0)


def buoy(std=0.2, error=None, **given):
    vehicle = ConstantVelocity(acceleration_noise=0.05)
    gnss = Installation("gnss", Gnss(std=std), rate=2.0, error=error, **given)
    return with_errors(Rig(vehicle, (gnss,), Gaussian(vehicle.start(), 0.1 * jnp.eye(4))))


def recorded(rig, seed, duration):
    return record(Scenario(rig, duration=duration, dt=0.5), jr.key(seed), output_rate=2.0)


def test_a_reading_held_back_is_one_that_was_never_there():
    """Its residual and spread are those of an estimate over the log without it."""
    rig, horizon = buoy(), 3.0
    log = recorded(rig, 1, 20.0)[0].log
    time, sensor = np.asarray(log.schedule.time), np.asarray(log.schedule.sensor)
    read = np.asarray(log.readings[0].measurement.position)[np.asarray(log.schedule.row)]
    seen = set()
    for phase in (0.0, 1.0):
        filter = Withholding(ExtendedKalman(), horizon=horizon, phase=phase)
        outcome = estimate(filter, rig, log).outcome
        window = np.floor((time + 1e-6) / horizon)
        held = (window % 2 == phase) & (window > 0) & (sensor == 0)
        schedule = log.schedule._replace(sensor=jnp.where(held, -1, sensor))
        without = estimate(ExtendedKalman(), rig, log._replace(schedule=schedule)).moments
        for k in np.flatnonzero(held):
            expected = read[k] - np.asarray(without.mean.position)[k]
            np.testing.assert_allclose(outcome.residual[k], expected, atol=1e-12)
            spread = np.sqrt(np.diag(np.asarray(without.cov)[k])[:2] + 0.2**2)
            np.testing.assert_allclose(outcome.std[k], spread, rtol=1e-9)
        assert not seen & set(np.flatnonzero(held))
        seen |= set(np.flatnonzero(held))
    assert seen == set(np.flatnonzero((sensor == 0) & (time > horizon - 1e-6)))


def evaluator(rig, recordings, horizons=(2.0, 5.0), **given):
    chosen = tuple(choose(rig, ["gnss.parameters.std", "error.std", "error.time_constant"]))
    cases = [Case(rig, one, **given) for one in recordings]
    return Evaluator(ExtendedKalman(), cases, chosen, np.full(3, 9.0), horizons)


def test_gradient_is_that_of_finite_differences():
    rig = buoy(error=CorrelatedError(0.5, 2.0))
    evaluate = evaluator(rig, [recorded(rig, 2, 20.0)[0]])
    point = evaluate.coordinates([0.3, 0.4, 3.0])
    gradient = evaluate(point).gradient
    for i, step in enumerate(1e-5 * np.eye(3)):
        slope = (evaluate(point + step).total - evaluate(point - step).total) / 2e-5
        assert gradient[i] == pytest.approx(slope, rel=1e-5)


def test_losses_of_logs_add_up_and_what_is_left_out_is_what_lacks():
    rig = buoy(error=CorrelatedError(0.5, 2.0))
    logs = alike([recorded(rig, seed, seconds)[0] for seed, seconds in ((1, 30.0), (2, 20.0))])
    point = np.log([0.3, 0.4, 3.0])
    both, *each = (evaluator(rig, some)(point) for some in (logs, logs[:1], logs[1:]))
    assert both.total == pytest.approx(sum(one.total for one in each), rel=1e-12)
    assert both.judged == sum(one.judged for one in each) == 2 * (60 + 40) - 2 * (3 + 9)
    parts = [
        evaluator(rig, logs[:1], left_out=span)(point) for span in ((-1.0, 9.0), (9.0, 40.0))
    ]
    assert each[0].total == pytest.approx(sum(part.total for part in parts), rel=1e-12)
    assert each[0].judged == sum(part.judged for part in parts)


def test_an_error_with_a_memory_is_tuned_in_all_places():
    """State, prior and installation are those of a rig that was made with the values."""
    rig = buoy(error=CorrelatedError(0.5, 2.0))
    chosen = choose(rig, ["error.std", "error.time_constant"])
    assert [t.key for t in chosen] == [
        "sensors.gnss.error.std",
        "sensors.gnss.error.time_constant",
    ]
    assert "sensors.gnss.error.std" in {t.key for t in choose(rig, None)}
    assert not any("error_of" in t.key for t in tunables(rig))
    changed = placed(rig, chosen, jnp.array([0.9, 7.0]))
    made = buoy(error=CorrelatedError(0.9, 7.0))
    log = recorded(made, 3, 10.0)[0]
    ours, theirs = (estimate(ExtendedKalman(), r, log).moments.cov for r in (changed, made))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_a_gate_takes_no_error_away():
    rig = buoy(error=CorrelatedError(0.5, 2.0), gate=0.01)
    evaluate = evaluator(rig, [recorded(rig, 2, 20.0)[0]])
    assert np.abs(evaluate(np.log([0.3, 0.4, 3.0])).gradient).min() > 1e-3


@pytest.mark.parametrize("horizon", [11.0, 0.0, -1.0])
def test_a_horizon_that_does_not_fit_is_refused(horizon):
    rig = buoy(error=CorrelatedError(0.5, 2.0))
    with pytest.raises(DataError, match=r"horizons: found .* at most half of the 20 s"):
        evaluator(rig, [recorded(rig, 2, 20.0)[0]], (1.0, horizon))


def test_horizons_beside_truth_are_refused():
    rig = buoy()
    recording, truth = recorded(rig, 2, 20.0)
    with pytest.raises(ConfigError, match="horizons"):
        fit(
            ExtendedKalman(),
            [Case(rig, recording, truth)],
            choose(rig, ["std"]),
            horizons=(1.0,),
        )


def rough(recording, seed, std, time_constant):
    """The readings with a second error, of a shorter memory."""
    (readings,) = recording.log.readings
    clean = np.asarray(readings.measurement.position)
    decay = np.exp(-0.5 / time_constant)
    shocks = np.random.default_rng(seed).normal(size=clean.shape)
    error = lfilter([1], [1, -decay], std * np.sqrt(1 - decay**2) * shocks, axis=0)
    measurement = type(readings.measurement)(jnp.asarray(clean + error))
    changed = readings._replace(measurement=measurement)
    return recording._replace(log=recording.log._replace(readings=(changed,)))


@pytest.fixture(scope="module")
def coverage():
    """Share of true positions in the 95 % bound on a log of over two hours that was left out.

    By rig (white, memory), objective and whether a short error is there besides that of 3 s.
    """
    source, shares = buoy(0.1, CorrelatedError(1.0, 3.0)), {}
    rigs = {
        "white": (buoy(0.5), ["gnss.parameters.std"]),
        "memory": (
            buoy(0.5, CorrelatedError(0.5, 1.0)),
            ["gnss.parameters.std", "error.std", "error.time_constant"],
        ),
    }
    for short in (False, True):

        def log(seed, duration, short=short):
            recording, truth = recorded(source, seed, duration)
            return (rough(recording, seed, 0.8, 0.5) if short else recording), truth

        tuned_on, (apart, truth) = [log(seed, 400.0)[0] for seed in (1, 2, 3)], log(99, 8000.0)
        for name, (rig, names) in rigs.items():
            chosen = choose(rig, names)
            for horizons in ((), HORIZONS):
                cases = [Case(rig, one) for one in tuned_on]
                found = fit(ExtendedKalman(), cases, chosen, Search(starts=1), horizons)
                tuned = placed(rig, chosen, jnp.asarray(found.values))
                estimates = estimate(ExtendedKalman(), tuned, apart)
                scores = score("tuned", estimates, apart, tuned, truth).scores
                shares[name, len(horizons), short] = scores.coverage_95["position"]
    return shares


@pytest.mark.slow
def test_readings_that_count_as_independent_make_a_filter_too_sure(coverage):
    assert coverage["white", 0, False] < 0.6
    # Horizons see the error's size, but no white noise has its memory.
    assert coverage["white", 0, False] + 0.1 < coverage["white", 3, False] < 0.88


@pytest.mark.slow
def test_an_error_with_a_memory_tuned_over_horizons_is_honest(coverage):
    assert 0.93 <= coverage["memory", 3, False] <= 0.97


@pytest.mark.slow
def test_over_horizons_the_longer_of_two_memories_is_what_counts(coverage):
    """The model has one memory where the readings have two: no numbers are right for all."""
    assert coverage["memory", 0, True] < coverage["memory", 3, True]
    assert 0.93 <= coverage["memory", 3, True] <= 0.97


def test_few_readings_that_are_lost_on_the_way_are_charged_and_many_are_a_wall(monkeypatch):
    rig = buoy(error=CorrelatedError(0.5, 2.0))
    evaluate = evaluator(rig, [recorded(rig, 2, 20.0)[0]])
    point = np.log([0.3, 0.4, 3.0])
    start = evaluate(point)
    evaluate.begin(start)
    monkeypatch.setattr(evaluate, "fused", start.fused + 1)
    monkeypatch.setattr(evaluate, "judged", start.judged + 1)
    assert evaluate(point).total == pytest.approx(start.total + 10.0, rel=1e-12)
    assert np.abs(evaluate(point).gradient).max() > 0
    monkeypatch.setattr(evaluate, "fused", round(1.05 * start.fused))
    assert evaluate(point).total == evaluate.ceiling
