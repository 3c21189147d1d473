"""What a study's runs say: scores with intervals, ratios to a baseline, curves over time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float
from scipy.special import betaincinv, stdtrit

from kedge.core.manifolds import Space, space_of
from kedge.evaluation.consistency import chi_square_interval
from kedge.evaluation.scores import Score
from kedge.studies.figures_of_merit import MeansOverTime, StudyScores, WindowScores
from kedge.studies.scores import Result, RunScores, TimeSums, finite
from kedge.studies.study import Study

BASELINE = "kalman"
REPLICATES = 2000
"""Of the bootstrap."""


class Curves(NamedTuple):
    """One filter over time: means over the runs, with the bounds that its NEES should keep."""

    time: Float[np.ndarray, " K"]
    rmse: Mapping[str, Float[np.ndarray, " K"]]
    """By field."""
    nees: Float[np.ndarray, " K"]
    nees_bounds: tuple[float, float]


def summarise_study(study: Study, results: Mapping[str, Result]) -> dict[str, StudyScores]:
    """The scores of all filters, with ratios to the baseline."""
    base = baseline(list(results))
    scores = {
        name: summarise(study, result, results[base], base) for name, result in results.items()
    }
    worth = np.array([(row.score.value, row.seconds_per_run) for row in scores.values()])
    better = (worth[:, None] <= worth).all(axis=2) & (worth[:, None] < worth).any(axis=2)
    return {
        name: replace(row, dominated_by=int(count))
        for (name, row), count in zip(scores.items(), better.sum(axis=0), strict=True)
    }


def baseline(names: Sequence[str]) -> str:
    """The filter that the others are compared with: "kalman" if it is there, else the first."""
    return BASELINE if BASELINE in names else names[0]


def summarise(
    study: Study,
    result: Result,
    other: Result | None = None,
    base: str = BASELINE,
) -> StudyScores:
    """The scores of one filter with 95 % intervals over runs, and ratios to those of ``other``.

    Runs that came out not finite are left out and counted as ``failed``.
    """
    good, states = finite(result), _states(study)
    other = result if other is None else other
    mean = interval(np.asarray(result.runs.time_mean_rms)[good])
    settled = _window(study, result.runs, good, compare(study, result, other))
    headline = _headline(study) if study.score == "pooled" else study.score
    return StudyScores(
        score=settled.rmse[headline] if study.score == "pooled" else mean,
        score_of=headline,
        settled=settled,
        time_mean_rms=mean,
        nees_dof=states.size,
        all_steps=_window(study, result.whole, good, compare(study, result, other, whole=True)),
        runs=len(good),
        failed=int((~good).sum()),
        seconds=result.seconds,
        seconds_per_run=result.seconds / len(good),
        compile_seconds=result.compile_seconds,
        compiler=result.compiler,
        baseline=base,
        ratio_to_baseline=settled.ratios[headline],
        by_time=by_time(study, result, other),
        windows=windows(study, result) if result.windows else {},
    )


def blank(study: Study) -> Result:
    """A result of two runs that all came out zero: it has every score's name."""
    plan, sensors = study.plan, len(study.scenario.rig.sensors)
    size, watches, runs = _states(study).size, len(_watches(study)), 2
    each = np.zeros(runs)
    scores = RunScores(
        time_mean_rms=each,
        squared=np.zeros((runs, size)),
        nees=each,
        coverage=each,
        within=np.zeros((runs, size)),
        nis=np.zeros((runs, sensors)),
        nis_dof=np.zeros((runs, sensors)),
        tracked=np.zeros((runs, watches)),
        singular=each,
        outlying=np.zeros((runs, sensors)),
    )
    times, readings = len(plan.time), len(plan.sensed)
    none = np.zeros(readings)
    sums = TimeSums(np.zeros(()), np.zeros((times, size)), np.zeros(times), none, none, none)
    apart = dict.fromkeys(plan.windows, scores)
    return Result(scores, scores, sums, 0.0, windows=apart)


def compare(
    study: Study, result: Result, other: Result, whole: bool = False
) -> dict[str, Score]:
    r"""Ratios of one filter's scores to another's over the same runs, by field and component.

    $\sqrt{\sum_i m_i / \sum_i m'_i}$ with $m_i$, $m'_i$ the mean squared errors of run i; the
    time-mean-rms is a ratio of means. The interval holds the middle 95 % of the ratios over
    :data:`REPLICATES` draws of whole runs, with replacement, in pairs: what a run's truth and
    readings do to both filters cancels. NaN for one run.

    Source: B. Efron and R. Tibshirani, "An Introduction to the Bootstrap", 1993, sections 8.3
    and 13.3 (percentile interval).
    """
    good = finite(result) & finite(other)
    cuts = parts_of(_states(study))
    both = [r.whole if whole else r.runs for r in (result, other)]
    columns = {}
    for name, cut in cuts.items():
        pair = (np.asarray(s.squared)[good][:, cut].sum(axis=1) for s in both)
        columns[name] = (*pair, 0.5)
    for number, name in enumerate(_watches(study)):
        pair = (np.asarray(s.tracked)[good][:, number] for s in both)
        columns[f"tracking.{name}"] = (*pair, 0.5)
    pair = (np.asarray(s.time_mean_rms)[good] for s in both)
    columns["time-mean-rms"] = (*pair, 1.0)
    count = int(good.sum())
    if not count:
        return dict.fromkeys(columns, Score(math.nan))
    table = np.stack([column for pair in columns.values() for column in pair[:2]], axis=1)
    powers = np.array([power for *_, power in columns.values()])

    def ratios(sums: Float[np.ndarray, " columns"]) -> Float[np.ndarray, " fields"]:
        with np.errstate(invalid="ignore", divide="ignore"):
            return (sums[0::2] / sums[1::2]) ** powers

    middle = ratios(table.sum(axis=0))
    if count < 2:
        lower = upper = np.full(len(powers), np.nan)
    else:
        # The same draws for every pair of filters, from no stream of the study's.
        draws = np.random.default_rng(1993)
        again = [
            ratios(np.bincount(draws.integers(0, count, count), minlength=count) @ table)
            for _ in range(REPLICATES)
        ]
        lower, upper = np.quantile(np.stack(again), [0.025, 0.975], axis=0)
    rows = zip(columns, middle.tolist(), lower.tolist(), upper.tolist(), strict=True)
    return {name: Score(*row) for name, *row in rows}


def by_time(study: Study, result: Result, other: Result) -> MeansOverTime:
    """Means over times after the burn-in: of the RMSE over runs, and of its ratio to another's.

    Where each time is an experiment of its own, such as a place at which a tag was put down,
    this is the mean of their results, to which a bad place adds no more than its own.
    """
    settled = study.plan.settled
    roots = [
        np.sqrt(np.asarray(r.sums.squared)[settled] / max(int(r.sums.total), 1))
        for r in (result, other)
    ]
    rmse, ratio = {}, {}
    for name, cut in _states(study).slices().items():
        errors, base = (np.linalg.norm(root[:, cut], axis=1) for root in roots)
        rmse[name] = float(errors.mean())
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio[name] = float((errors / base).mean())
    return MeansOverTime(rmse, ratio)


def curves(study: Study, result: Result) -> Curves:
    r"""Means over runs at each time; NEES with the two-sided 95 % bounds of its mean.

    Source: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to
    Tracking and Navigation", 2001, section 5.4.2.
    """
    states, sums = _states(study), result.sums
    count = max(int(sums.total), 1)
    squared = np.asarray(sums.squared) / count
    return Curves(
        time=study.plan.time,
        rmse={
            name: np.sqrt(squared[:, cut].sum(axis=1)) for name, cut in states.slices().items()
        },
        nees=np.asarray(sums.nees) / count,
        nees_bounds=chi_square_interval(states.size, count),
    )


def windows(study: Study, result: Result) -> dict[str, WindowScores]:
    """The scores over each of the study's windows, and over the rest after the burn-in.

    ``nis_per_dof`` is that of all sensors together, per degree of freedom.
    """
    good, sums, scores = finite(result), result.sums, {}
    for name, window in study.plan.windows.items():
        freedom = float(np.asarray(sums.nis_dof)[window.sensed].sum())
        nis = float(np.asarray(sums.nis)[window.sensed].sum())
        scores[name] = replace(
            _window(study, result.windows[name], good),
            nis_per_dof=nis / freedom if freedom else math.nan,
            seconds_per_run=result.seconds / len(good) * float(window.events.mean()),
        )
    return scores


def interval(values: Float[np.ndarray | Array, " runs"]) -> Score:
    r"""The mean of independent values and $\bar x \pm t_{n-1} \, s / \sqrt n$.

    Source: Student, "The probable error of a mean", Biometrika 6(1), 1908.
    """
    count = len(values)
    if count == 0:
        return Score(math.nan)
    mean = float(np.mean(values))
    if count == 1:
        return Score(mean)
    half = float(stdtrit(count - 1, 0.975) * np.std(values, ddof=1) / np.sqrt(count))
    return Score(mean, mean - half, mean + half)


def share(values: Float[np.ndarray, " runs"]) -> Score:
    r"""The mean of shares, one a run, and the exact interval of so many yes-or-no trials.

    $B^{-1}_{\alpha/2}(k, n - k + 1)$ to $B^{-1}_{1-\alpha/2}(k + 1, n - k)$ with the sum k of
    the shares of n runs: exact for one time a run. Over more it is wide enough even if the
    times of a run all go the same way.

    Source: C. Clopper and E. Pearson, "The use of confidence or fiducial limits illustrated in
    the case of the binomial", Biometrika 26(4), 1934.
    """
    count, total = len(values), float(np.sum(values))
    if not count or not math.isfinite(total):
        return Score(math.nan)
    outside = max(count - total, 0.0)
    lower = float(betaincinv(total, outside + 1, 0.025)) if total > 0 else 0.0
    upper = float(betaincinv(total + 1, outside, 0.975)) if outside > 0 else 1.0
    return Score(total / count, lower, upper)


def _within(states: Space, shares: Float[np.ndarray, "runs n"]) -> dict[str, Score]:
    """Shares of times within 3 standard deviations; of a field that of its worst component."""
    each = [share(column) for column in shares.T]
    return {
        name: min(each[cut], key=lambda score: score.value)
        for name, cut in parts_of(states).items()
    }


def _window(
    study: Study, scores: RunScores, good: np.ndarray, ratios: Mapping[str, Score] | None = None
) -> WindowScores:
    """RMSE, NEES, NIS and coverage of the good runs, each with its interval."""
    squared, tracked = (np.asarray(s)[good] for s in (scores.squared, scores.tracked))
    nis, nis_dof, outlying = {}, {}, {}
    for number, installation in enumerate(study.scenario.rig.sensors):
        values = np.asarray(scores.nis)[good][:, number]
        dofs = np.asarray(scores.nis_dof)[good][:, number]
        fused = np.isfinite(values)
        nis[installation.name] = interval(values[fused])
        nis_dof[installation.name] = interval(dofs[fused]).value
        shares = np.asarray(scores.outlying)[good][:, number]
        outlying[installation.name] = interval(shares[np.isfinite(shares)]).value
    return WindowScores(
        rmse={
            name: _root(interval(squared[:, cut].sum(axis=1)))
            for name, cut in parts_of(_states(study)).items()
        },
        tracking={
            name: _root(interval(tracked[:, i])) for i, name in enumerate(_watches(study))
        },
        nees=interval(np.asarray(scores.nees)[good]),
        singular=interval(np.asarray(scores.singular)[good]).value,
        nis=nis,
        nis_dof=nis_dof,
        outlying=outlying,
        coverage_95=interval(np.asarray(scores.coverage)[good]),
        within_3_sigma=_within(_states(study), np.asarray(scores.within)[good]),
        ratios=ratios or {},
    )


def _root(score: Score) -> Score:
    """The root of a mean and of the ends of its interval."""
    lower, upper = (float(np.sqrt(max(end, 0.0))) for end in score[1:])
    return Score(float(np.sqrt(score.value)), lower, upper)


def _watches(study: Study) -> tuple[str, ...]:
    world = study.scenario.world
    return () if world is None else world.watches


def _states(study: Study) -> Space:
    return space_of(type(study.scenario.rig.prior.mean))


def _headline(study: Study) -> str:
    """The field that a filter is judged by."""
    fields = _states(study).cls._fields
    return study.field or ("position" if "position" in fields else fields[0])


def parts_of(states: Space) -> dict[str, slice]:
    """Every field, every component of fields of up to 3 components, a position in plan."""
    parts = {}
    for name, cut in states.slices().items():
        parts[name] = cut
        if 1 < cut.stop - cut.start <= 3:
            parts |= {states.labels[i]: slice(i, i + 1) for i in range(cut.start, cut.stop)}
    return parts | _in_plan(states)


def _in_plan(states: Space) -> dict[str, slice]:
    """Of a position in space, what a map shows of it."""
    cut = states.slices().get("position", slice(0, 0))
    return {"horizontal": slice(cut.start, cut.start + 2)} if cut.stop - cut.start == 3 else {}
