"""Which logs, and which parts of them, ``kedge tune`` tunes on and which it leaves out."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kedge.config.filters import build_filter
from kedge.config.problem import Problem
from kedge.core.errors import ConfigError, DataError
from kedge.estimation.batch import estimate
from kedge.estimation.log import alike
from kedge.evaluation.score import Run, score
from kedge.reports.tuning_report import part_scores
from kedge.tuning.evaluator import Case
from kedge.tuning.tunable import tunables


class Span(NamedTuple):
    """A part of a log that is scored by itself."""

    name: str
    log: int
    begin: float
    end: float
    """s."""


def leaves_out(
    count: int, blocks: int | None, asked: bool | None, hold_out: float | None
) -> bool:
    """Whether each of the logs, or of the blocks of one log, is left out in turn.

    Raises:
        ConfigError: what was asked for contradicts itself.
    """
    if blocks is not None and count > 1:
        raise ConfigError(
            f"--blocks: found {count} logs, expected one; of several each is left out in turn"
        )
    if blocks is not None and blocks < 2:
        raise ConfigError(
            f"--blocks: found {blocks}, expected at least 2, of which one is left out at a time"
        )
    if asked and blocks is None and count == 1:
        raise ConfigError(
            "--leave-one-out: found one log, expected several, or --blocks K to leave out parts"
        )
    if asked is False and blocks is not None:
        raise ConfigError("--blocks: found --no-leave-one-out as well, expected one of them")
    if hold_out is not None and (blocks is not None or count > 1):
        raise ConfigError(
            "--hold-out: found it with several logs or blocks, of which each is left out in "
            "turn; expected one of the two"
        )
    several = blocks is not None or count > 1
    return several if asked is None else asked


def check_logs(logs: Sequence[str], problems: Sequence[Problem]) -> None:
    """Refuse a log that is there twice, and logs that make other rigs of one file.

    Raises:
        ConfigError: naming the log.
    """
    first = {t.key: t.value for t in tunables(problems[0].rig)}
    seen: dict[Any, str] = {}
    for log, problem in zip(logs, problems, strict=True):
        content = problem.inputs_digest, problem.recording.stamps.tobytes()
        if content in seen:
            raise ConfigError(f"{log}: found the same log as {seen[content]}, expected another")
        seen[content] = log
        others = {t.key: t.value for t in tunables(problem.rig)}
        if odd := [key for key in first.keys() | others if first.get(key) != others.get(key)]:
            raise ConfigError(
                f"{log}: found {min(odd)} = {others.get(min(odd))}, expected "
                f"{first.get(min(odd))} as with {logs[0]}: logs of one rig"
            )


def cases_of(problems: Sequence[Problem], with_truth: bool, share: float) -> list[Case]:
    """The logs as they are tuned on; made alike, so that one compiled program does for all."""
    recordings = [problem.recording for problem in problems]
    try:
        recordings = alike(recordings)
    except DataError:
        pass  # a sensor that is silent in one of them: each has its own program
    return [
        Case(
            problem.rig,
            recording,
            problem.truth if with_truth else None,
            np.inf if share == 1 else duration(problem) * share,
        )
        for problem, recording in zip(problems, recordings, strict=True)
    ]


def duration(problem: Problem) -> float:
    """Of a log, in s."""
    return float(problem.recording.log.schedule.time[-1])


def spans_of(problems: Sequence[Problem], blocks: int | None, share: float) -> list[Span]:
    """What is scored by itself: logs, blocks of one, or what is tuned on and held out of it."""
    ends = [duration(problem) for problem in problems]
    if len(problems) > 1:
        return [Span(f"log_{i + 1}", i, -1.0, end + 1.0) for i, end in enumerate(ends)]
    if blocks is not None:
        cuts = np.linspace(0.0, ends[0], blocks + 1)
        cuts[0], cuts[-1] = -1.0, ends[0] + 1.0
        return [Span(f"block_{i + 1}", 0, *cuts[i : i + 2].tolist()) for i in range(blocks)]
    tuned_on = Span("tuning", 0, -1.0, ends[0] * share)
    held_out = Span("held_out", 0, ends[0] * share, ends[0] + 1.0)
    return [tuned_on, held_out] if share < 1 else [tuned_on]


def without_each(cases: Sequence[Case], spans: Sequence[Span]) -> list[list[Case]]:
    """By part that is left out, what remains."""
    if len(cases) > 1:
        return [[*cases[: span.log], *cases[span.log + 1 :]] for span in spans]
    return [[cases[0]._replace(left_out=(span.begin, span.end))] for span in spans]


def scores_of(
    scored: Mapping[str, Sequence[Problem]], spans: Sequence[Span], filter: str
) -> dict[str, dict[str, Any]]:
    """By column and part, the scores: ``scored`` has by column the log and rig of each part."""
    runs: dict[int, Run] = {}

    def run(name: str, problem: Problem) -> Run:
        if id(problem) not in runs:
            estimates = estimate(build_filter(filter), problem.rig, problem.recording.log)
            runs[id(problem)] = score(
                name, estimates, problem.recording, problem.rig, problem.truth
            )
        return runs[id(problem)]

    return {
        name: {
            span.name: part_scores(run(name, problem), span.begin, span.end)
            for span, problem in zip(spans, by_part, strict=True)
        }
        for name, by_part in scored.items()
    }


def certainty(scores: Mapping[str, Mapping[str, Any]]) -> float | None:
    """Mean NEES of parts by its expectation; None where there is no truth."""
    ratios = [part["nees"] / part["nees_dof"] for part in scores.values() if "nees" in part]
    return float(np.mean(ratios)) if ratios else None


def growth(scores: Mapping[str, Mapping[str, Any]]) -> float | None:
    """The most that the error of a field grows by on parts left out; None without truth."""
    squared: dict[str, list[tuple[float, float]]] = {}
    for part, before in scores["start"].items():
        for field, error in before.get("rmse", {}).items():
            after = scores["left_out"][part]["rmse"][field]
            squared.setdefault(field, []).append((error**2, after**2))
    sums = [np.sum(pairs, axis=0) for pairs in squared.values()]
    return max((float(np.sqrt(b / a)) for a, b in sums if a > 0), default=None)


def named(logs: Sequence[str]) -> Iterator[tuple[str, str]]:
    """The logs by the names of their parts."""
    for number, log in enumerate(logs, start=1):
        yield f"log_{number}", log
