"""Studies: scores against a run by hand, pairing, and what changes no number."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.compiler.machine import is_available
from kedge.core.beliefs import Gaussian
from kedge.core.errors import ConfigError
from kedge.estimation.batch import estimate
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.record import record
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.dead_reckoning import DeadReckoning
from kedge.filters.gaussian.kalman import Kalman
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import schedule, simulate, with_readings
from kedge.studies.measure import squared_distance
from kedge.studies.scores import (
    Result,
    RunScores,
    Tally,
    pack,
    unpack,
)
from kedge.studies.study import Study
from kedge.studies.summary import (
    baseline,
    blank,
    compare,
    curves,
    interval,
    share,
    summarise,
    summarise_study,
    windows,
)
from kedge.studies.trials import Trials, run_study, stream
from kedge.vehicles.constant_velocity import ConstantVelocity

VEHICLE = ConstantVelocity()
RIG = Rig(
    VEHICLE,
    (Installation("gnss", Gnss(), rate=0.5),),
    Gaussian(VEHICLE.start(), jnp.diag(jnp.array([1.0, 1.0, 0.1, 0.1]))),
)
SCENARIO = Scenario(RIG, duration=10.0, dt=0.5)
FILTERS = {"kalman": Kalman(), "ensemble:count=8": EnsembleKalman(count=8)}


@pytest.fixture(scope="module")
def pooled():
    spans = {"early": [(0.0, 2.0)], "gap": [(3.1, 3.4)]}
    return Study(SCENARIO, burn_in=2.0, seed=3, windows=spans)


@pytest.fixture(scope="module")
def results(pooled):
    return run_study(pooled, FILTERS, 5, chunk=3)


def by_hand(study, filter, name, run):
    """Errors of one run after the burn-in, and which of them lie at readings."""
    truth = simulate(study.scenario, jr.fold_in(stream(study.seed, "truth"), run))
    plan = schedule(study.scenario, 1 / study.scenario.dt)
    log = with_readings(plan.log, study.scenario, truth)
    key = jr.fold_in(stream(study.seed, f"filter {name}"), run)
    mean, cov = estimate(filter, RIG, log, key).moments
    last = plan.outputs  # after control and reading of the same time
    error = np.concatenate(
        [np.asarray(a) - np.asarray(b)[last] for a, b in zip(truth.truth, mean, strict=True)],
        axis=1,
    )
    time, std = plan.stamps[last] / 1e9, np.sqrt(np.diagonal(cov[last], axis1=1, axis2=2))
    late = time > study.burn_in
    return error[late], (time % 2 == 0)[late], std[late]


def test_scores_are_those_of_a_run_by_hand(pooled, results):
    error, sensed, std = by_hand(pooled, Kalman(), "kalman", 4)
    assert len(error) == 16
    squared = results["kalman"].runs.squared[4]
    np.testing.assert_allclose(squared, np.mean(error**2, axis=0), rtol=1e-9)
    inside = np.mean(np.abs(error) <= 3 * std, axis=0)
    np.testing.assert_allclose(results["kalman"].runs.within[4], inside, rtol=1e-9)

    analysed = run_study(replace(pooled, score="time-mean-rms"), {"kalman": Kalman()}, 5)
    expected = np.mean(np.sqrt(np.mean(error[sensed] ** 2, axis=1)))
    np.testing.assert_allclose(analysed["kalman"].runs.time_mean_rms[4], expected, rtol=1e-9)
    assert sensed.sum() == 4


def test_random_filters_draw_from_their_own_stream(pooled, results):
    name = "ensemble:count=8"
    error, *_ = by_hand(pooled, FILTERS[name], name, 1)
    squared = results[name].runs.squared[1]
    np.testing.assert_allclose(squared, np.mean(error**2, axis=0), rtol=1e-9)


def test_another_filter_more_runs_or_another_chunk_change_no_number(pooled, results):
    name = "ensemble:count=8"
    others = {"dead-reckoning": DeadReckoning(), name: FILTERS[name]}
    again = run_study(pooled, others, 3, chunk=3)
    jax.tree.map(
        lambda a, b: np.testing.assert_array_equal(a[:3], b),
        (results[name].runs, results[name].whole),
        (again[name].runs, again[name].whole),
    )
    # Nine runs are two parts, the second of which is filled up.
    narrow, wide = (
        run_study(pooled, {name: FILTERS[name]}, 9, chunk=chunk)[name] for chunk in (3, 9)
    )
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12),
        (narrow.runs, narrow.whole, narrow.sums),
        (wide.runs, wide.whole, wide.sums),
    )
    assert wide.sums.total == 9
    moved = run_study(replace(pooled, seed=4), {name: FILTERS[name]}, 3, chunk=3)
    assert (moved[name].runs.squared != again[name].runs.squared).all()


@pytest.mark.skipif(not is_available(), reason="needs the extra native")
def test_both_engines_score_alike_and_machine_code_does_whatever_the_chunk(pooled, monkeypatch):
    monkeypatch.setenv("KEDGE_ENGINE", "xla")
    by_xla = run_study(pooled, {"kalman": Kalman()}, 5, chunk=2)["kalman"]
    monkeypatch.setenv("KEDGE_ENGINE", "native")
    some, whole = (
        run_study(pooled, {"kalman": Kalman()}, 5, chunk=chunk)["kalman"] for chunk in (3, 5)
    )
    jax.tree.map(np.testing.assert_array_equal, some.example, whole.example)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-11),
        (some.runs, some.whole, some.sums, some.example),
        (by_xla.runs, by_xla.whole, by_xla.sums, by_xla.example),
    )
    assert (some.compiler, whole.compiler, by_xla.compiler) == ("native", "native", "xla")


def test_chunks_are_the_same_in_any_order_and_after_a_file(pooled, results):
    trials = Trials(pooled, FILTERS, 5, chunk=3)
    parts = {number: trials.part(number) for number in reversed(trials.chunks)}
    tally = Tally(list(FILTERS))
    for number in trials.chunks:
        tally.add(unpack(pack(parts[number]), list(FILTERS)))
    for name, found in tally.results().items():
        whole = results[name]
        assert found.compiler == whole.compiler
        jax.tree.map(
            np.testing.assert_array_equal,
            (found.runs, found.whole, found.windows, found.sums, found.example),
            (whole.runs, whole.whole, whole.windows, whole.sums, whole.example),
        )
    assert tally.truth["position"].shape == (20, 2)
    assert tally.readings["gnss.position"].shape == (5, 2)


def test_sums_over_time_agree_with_scores_by_run(pooled, results):
    """The same errors, added up the other way."""
    trials = Trials(pooled, FILTERS, 5)
    for result in results.values():
        late = np.asarray(result.sums.squared)[trials.plan.settled] / 5
        np.testing.assert_allclose(late.mean(axis=0), result.runs.squared.mean(axis=0))
        np.testing.assert_allclose(np.mean(result.sums.nees) / 5, result.whole.nees.mean())
        np.testing.assert_allclose(np.mean(result.sums.nis) / 5, result.whole.nis.mean())
        assert (result.sums.nis_dof == 10).all()
        drawn = curves(pooled, result)
        np.testing.assert_allclose(
            np.mean(drawn.rmse["position"] ** 2),
            result.whole.squared[:, :2].sum(axis=1).mean(),
        )
        low, high = drawn.nees_bounds
        assert low < 4 < high


def test_windows_are_scored_as_the_whole_is(pooled, results):
    """The burn-in's rest is what the whole is scored by; a window between steps is left out."""
    result = results["kalman"]
    found = record(windows(pooled, result))
    assert list(found) == ["early", "else"]
    whole = record(summarise(pooled, result))
    for key in ("rmse", "rmse_ci", "nees", "nees_ci", "within_3_sigma", "coverage_95"):
        assert found["else"][key] == whole[key], key
    assert found["early"]["nees"] != whole["nees"]
    assert found["early"]["seconds_per_run"] == pytest.approx(whole["seconds_per_run"] / 5)
    np.testing.assert_allclose(
        4 * found["early"]["nees"] + 16 * found["else"]["nees"], 20 * whole["all_steps"]["nees"]
    )
    late, rest = replace(pooled, windows={"late": [(8.0, 10.0)]}).plan.windows.values()
    assert (late.events.sum(), rest.events.sum()) == (4, 12)
    assert not (late.events & rest.events).any()


def test_a_share_has_its_interval():
    """Clopper and Pearson's for 0, 1 and all of 10: in closed form, and as tables have it."""
    tail = 1 - 0.025 ** (1 / 10)
    np.testing.assert_allclose(share(np.zeros(10)), (0.0, 0.0, tail))
    np.testing.assert_allclose(share(np.ones(10)), (1.0, 1 - tail, 1.0))
    np.testing.assert_allclose(share(np.eye(10)[0]), (0.1, 0.0025, 0.4450), atol=5e-5)
    assert np.isnan(share(np.array([]))).all()


def test_ratios_are_paired(pooled, results):
    """What all of a run's filters suffer alike is no uncertainty of their ratio."""
    name = "ensemble:count=8"
    found = summarise_study(pooled, results)
    assert found[name].baseline == baseline(list(FILTERS)) == "kalman"
    assert found["kalman"].ratio_to_baseline == (1, 1, 1)
    position = found[name].score.value / found["kalman"].score.value
    value, low, high = found[name].ratio_to_baseline
    assert value == pytest.approx(position)
    assert low < position < high
    assert baseline(["extended", "unscented"]) == "extended"

    draws = np.random.default_rng(0)
    hard = draws.chisquare(2, 400)  # some runs are hard for both
    gap = 1.1 * np.exp(draws.normal(0, 0.2, 400))
    squared = np.repeat(hard[:, None], 4, axis=1)
    gaps = squared * gap[:, None]
    first, second = (
        Result(_runs(values, times), _runs(values), results[name].sums, 1.0)
        for values, times in ((gaps, 3 * gap), (squared, np.ones(400)))
    )
    # A mean of errors is no root of a mean of squares.
    ratios = compare(pooled, first, second)
    assert ratios["time-mean-rms"].value == pytest.approx(3 * gap.mean())
    ratio = ratios["position"]
    np.testing.assert_allclose(ratio.value, np.sqrt(gaps.sum() / squared.sum()))
    # The delta method on the linearised ratio of means.
    spread = np.std(gaps[:, 0] - ratio.value**2 * squared[:, 0], ddof=1) / 20
    half = 1.96 * spread / hard.mean() / (2 * ratio.value)
    np.testing.assert_allclose(ratio.lower, ratio.value - half, atol=0.1 * half)
    np.testing.assert_allclose(ratio.upper, ratio.value + half, atol=0.1 * half)
    # An interval of 90 % would be narrower by 16 %.
    assert ratio.upper - ratio.lower == pytest.approx(2 * half, rel=0.05)


def test_filters_are_judged_by_the_field_that_is_named(pooled, results):
    found = summarise(replace(pooled, field="velocity"), results["kalman"])
    assert (found.score_of, found.score) == ("velocity", found.settled.rmse["velocity"])
    with pytest.raises(ConfigError, match="did you mean 'velocity'"):
        replace(pooled, field="velocty").check()


def _runs(squared, times=None):
    rows = len(squared)
    once = np.ones(rows)
    ones, none = np.ones((rows, 1)), np.zeros((rows, 0))
    inside = np.ones_like(squared)
    each = once if times is None else times
    return RunScores(each, squared, once, once, inside, ones, ones, none, 0 * once, 0 * ones)


def test_a_start_near_the_truth_is_as_far_off_as_the_prior_says():
    """After a spin-up the truth is far from the prior; around it the filter is consistent."""
    scenario = Scenario(RIG, duration=2.0, dt=0.5, spin_up=30.0)
    study = Study(scenario, start="truth")
    found = summarise(study, run_study(study, {"kalman": Kalman()}, 64)["kalman"])
    _, low, high = found.settled.nees
    assert low < found.nees_dof == 4 < high
    assert high - low < 1.5
    lost = Study(scenario, start="prior")
    far = summarise(lost, run_study(lost, {"kalman": Kalman()}, 64)["kalman"])
    assert far.settled.nees.value > 40


@pytest.mark.parametrize("size", [4, 16])
def test_nees_of_small_and_of_large_states(size):
    rng = np.random.default_rng(size)
    root, error = rng.normal(size=(size, size)), 1e3 * rng.normal(size=size)
    cov, far = jnp.asarray(root @ root.T), jnp.asarray(error)
    expected = error @ np.linalg.solve(cov, error)
    np.testing.assert_allclose(squared_distance(cov, far), expected, rtol=1e-9)
    assert np.isnan(squared_distance(cov.at[1, 1].set(-1.0), far))


def test_summaries_leave_out_what_failed_and_count_it(pooled, results):
    runs = RunScores(
        time_mean_rms=np.array([1.0, 3.0, np.nan]),
        squared=np.array([[1.0, 3.0, 1.0, 1.0], [4.0, 8.0, 1.0, 1.0], [np.nan] * 4]),
        nees=np.array([3.0, 5.0, np.nan]),
        coverage=np.array([1.0, 0.5, 0.0]),
        within=np.array([[1.0, 0.5, 1.0, 1.0], [1.0, 1.0, 1.0, 0.0], [0.0] * 4]),
        nis=np.array([[1.0], [np.nan], [np.nan]]),
        nis_dof=np.array([[2.0], [np.nan], [np.nan]]),
        tracked=np.zeros((3, 0)),
        singular=np.array([0.0, 0.25, 1.0]),
        outlying=np.array([[0.5], [np.nan], [1.0]]),
    )
    result = Result(runs, runs, results["kalman"].sums, seconds=6.0)
    found = record(summarise(pooled, result))
    assert found["failed"] == 1
    assert found["runs"] == 3
    assert found["seconds_per_run"] == 2.0
    np.testing.assert_allclose(found["rmse"]["position"], 8**0.5)
    np.testing.assert_allclose(found["rmse"]["position_x"], 2.5**0.5)
    assert (found["score"], found["score_of"]) == (found["rmse"]["position"], "position")
    assert (found["time_mean_rms"], found["nees"], found["coverage_95"]) == (2.0, 4.0, 0.75)
    assert found["singular"] == 0.125
    assert found["outlying"] == {"gnss": 0.5}
    assert (found["nis"]["gnss"], found["nis_dof"]["gnss"]) == (1.0, 2.0)
    within = found["within_3_sigma"]
    assert (within["position_x"], within["position"], within["velocity_y"]) == (1.0, 0.75, 0.5)
    by_reading = replace(pooled, score="time-mean-rms")
    result = result._replace(sums=blank(by_reading).sums)
    timed = record(summarise(by_reading, result))
    assert (timed["score"], timed["score_of"]) == (2.0, "time-mean-rms")


def test_the_interval_is_that_of_student():
    """Student's 97.5 % quantile with two degrees of freedom is 4.30265273."""
    found = interval(np.array([1.0, 2.0, 3.0]))
    half = 4.302652729911275 / 3**0.5
    np.testing.assert_allclose(found, (2.0, 2.0 - half, 2.0 + half))
    assert np.isnan(interval(np.array([1.0]))[1:]).all()
    assert np.isnan(interval(np.array([]))).all()


@pytest.mark.parametrize(
    ("change", "runs", "message"),
    [
        ({}, 0, "runs: found 0, expected 1 or more"),
        ({"score": "rmse"}, 1, "score: found 'rmse', expected one of"),
        ({"start": "here"}, 1, "start: found 'here', expected one of"),
        ({"burn_in": 10.0}, 1, "burn_in: found 10 s, expected 0 or more and less than"),
        ({"burn_in": 9.9, "score": "time-mean-rms"}, 1, None),
        ({"scenario": SCENARIO, "burn_in": -1.0}, 1, "burn_in: found -1 s"),
    ],
)
def test_refusals(pooled, change, runs, message):
    study = replace(pooled, **change)
    if message is None:  # a reading at 10 s is left
        assert len(run_study(study, {"dead-reckoning": DeadReckoning()}, runs)) == 1
        return
    with pytest.raises(ConfigError, match=message):
        run_study(study, FILTERS, runs)


def test_nothing_to_score_is_said(pooled):
    silent = Rig(VEHICLE, (), RIG.prior)
    study = Study(Scenario(silent, 10.0, 0.5), score="time-mean-rms")
    with pytest.raises(ConfigError, match="nothing is scored after 0 s"):
        run_study(study, {"dead-reckoning": DeadReckoning()}, 1)
