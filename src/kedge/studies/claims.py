"""Claims and expected figures of a scenario, judged by the intervals of a study's scores."""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from kedge.core.conditions import Comparison, Term, parse_condition, parse_term
from kedge.core.errors import ConfigError
from kedge.evaluation.record import by_name
from kedge.evaluation.scores import Score
from kedge.studies.figures_of_merit import JudgedClaim, StudyScores
from kedge.studies.scores import Result
from kedge.studies.study import Study
from kedge.studies.summary import compare

TRUE, FALSE, OPEN = "true", "false", "not decided by these runs"
RELATIONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


class Evidence(NamedTuple):
    """What a study came to, to judge by."""

    study: Study
    results: Mapping[str, Result]
    filters: Mapping[str, StudyScores]


class Judgement(NamedTuple):
    """A verdict, and the figures that decide it."""

    verdict: str
    figures: str


def judge(condition: str, evidence: Evidence) -> Judgement:
    """Judge a condition by 95 % intervals over the runs.

    A comparison is true if it holds for every value in the interval, false if for none, else
    these runs do not decide it. Errors of two filters are compared in pairs, by the ratio over
    the same runs. What has no interval, such as time, is taken as it was measured. An empty
    condition stays open.

    Raises:
        ConfigError: the condition cannot be understood.
    """
    if not condition:
        return Judgement(OPEN, "this study does not test it")
    parts = [_compared(comparison, evidence) for comparison in parse_condition(condition)]
    verdicts = [part.verdict for part in parts]
    whole = FALSE if FALSE in verdicts else OPEN if OPEN in verdicts else TRUE
    return Judgement(whole, "; ".join(part.figures for part in parts))


def judge_claim(
    claim: Any, evidence: Evidence, configuration: Mapping[str, Any]
) -> JudgedClaim:
    """Judge a claim, unless the study is under other settings than it is about.

    What it ``means`` is kept under the verdict that it speaks of, and none other.

    Raises:
        ConfigError: its test or a setting cannot be understood.
    """
    judgement, means = judge(claim.test, evidence), claim.means
    for key, wanted in claim.under.items():
        value: Any = configuration
        for part in key.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        if value is None:
            raise ConfigError(f"claims: under: found {key!r}, expected a key of the scenario")
        if value != wanted:
            why = f"not tested here: {key} is {value!r}, and the claim is about {wanted!r}"
            judgement, means = Judgement(OPEN, why), ""
    if claim.outcome not in ("", judgement.verdict):
        means = ""
    return JudgedClaim(claim.text, claim.source, claim.test, means, *judgement)


def look_up(score: str, evidence: Evidence) -> Score | None:
    """A score with its interval; None if these filters do not have it.

    Raises:
        ConfigError: the score's name cannot be understood.
    """
    value = _value(parse_term(score), evidence)
    return None if isinstance(value, str) else value


def judge_band(score: str, between: Sequence[float], evidence: Evidence) -> Judgement:
    """Judge whether a score lies where it is expected to.

    True if the score itself lies in the band, false if not even its interval reaches it.

    Raises:
        ConfigError: the score's name cannot be understood.
    """
    value, (low, high) = _value(parse_term(score), evidence), between
    if isinstance(value, str):
        return Judgement(OPEN, value)
    if low <= value.value <= high:
        verdict = TRUE
    else:
        reaches = value.lower <= high and value.upper >= low
        verdict = OPEN if reaches or math.isnan(value.lower) else FALSE
    return Judgement(verdict, f"{_shown(value)}, expected {low:g} to {high:g}")


def _compared(comparison: Comparison, evidence: Evidence) -> Judgement:
    left, relation, right, factor = comparison
    first = _value(left, evidence)
    if isinstance(first, str):
        return Judgement(OPEN, first)
    if not isinstance(right, Term):
        verdict = _decided(first, relation, factor * right)
        return Judgement(verdict, f"{left.filter} {left.score} {_shown(first)}")
    second = _value(right, evidence)
    if isinstance(second, str):
        return Judgement(OPEN, second)
    paired = _paired(left, right, evidence)
    if paired is not None:
        figures = f"{left.filter} / {right.filter}: {left.score} ratio {_shown(paired)}"
        if factor != 1:
            figures += f", asked for {relation} {factor:g}"
        return Judgement(_decided(paired, relation, factor), figures)
    ends = sorted((factor * second.lower, factor * second.upper))
    gap = Score(
        first.value - factor * second.value, first.lower - ends[1], first.upper - ends[0]
    )
    figures = (
        f"{left.filter} {left.score} {_shown(first)}, "
        f"{right.filter} {right.score} {_shown(second)}"
    )
    return Judgement(_decided(gap, relation, 0.0), figures)


def _decided(value: Score, relation: str, bound: float) -> str:
    if not all(math.isfinite(number) for number in value):
        return OPEN
    ends = {RELATIONS[relation](end, bound) for end in value[1:]}
    return OPEN if len(ends) > 1 else TRUE if True in ends else FALSE


def _paired(left: Term, right: Term, evidence: Evidence) -> Score | None:
    """The ratio of two errors over the same runs, where both are the same kind of error."""
    if left.score != right.score:
        return None
    whole = left.score.startswith("all_steps.")
    name = left.score.removeprefix("all_steps.").removeprefix("rmse.").replace("_", "-")
    if name == "score":
        name = evidence.filters[left.filter].score_of
    results = (evidence.results[term.filter] for term in (left, right))
    ratios = compare(evidence.study, *results, whole=whole)
    return {key.replace("_", "-"): ratio for key, ratio in ratios.items()}.get(name)


def _value(term: Term, evidence: Evidence) -> Score | str:
    """A score with its interval (itself twice where it has none), or why there is none."""
    if term.filter not in evidence.filters:
        return f"{term.filter} is not among the filters of this study"
    first, *others = term.score.split(".")
    name = ".".join(["ratio_to_baseline" if first == "ratio" else first, *others])
    value = by_name(evidence.filters[term.filter]).get(name)
    if value is None or math.isnan(value.value):
        return f"{term.filter} has no score called {term.score}"
    return value


def _shown(value: Score) -> str:
    if value.lower == value.upper:
        return f"{value.value:.4g}"
    return f"{value.value:.4g} [{value.lower:.4g}, {value.upper:.4g}]"
