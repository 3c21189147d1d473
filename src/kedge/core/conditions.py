"""Conditions on scores, as scenario files state them: ``ensemble:count=500.ratio >= 1.0``.

    condition  = comparison, { " and ", comparison }
    comparison = term, ("<" | "<=" | ">" | ">="), ([number, "*"], term | number)
    term       = filter, ".", score              e.g. kalman.all_steps.rmse.position

Nothing is executed: a condition is read into these tuples, and scores are looked up.
"""

import re
from typing import NamedTuple

from kedge.core.errors import ConfigError

HEADS = (
    "all_steps",
    "by_time",
    "coverage_95",
    "dominated_by",
    "failed",
    "nees",
    "nis",
    "ratio",
    "ratios",
    "rmse",
    "score",
    "seconds",
    "seconds_per_run",
    "time_mean_rms",
    "tracking",
    "windows",
    "within_3_sigma",
)
"""How the name of a score may begin; a filter's own name may have dots in it."""

_TERM = re.compile(rf"(?P<filter>\S+?)\.(?P<score>(?:{'|'.join(HEADS)})(?:\.[\w.-]+)?)")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_COMPARISON = re.compile(r"\s*(\S+)\s+(<=|>=|<|>)\s+(?:(\S+)\s*\*\s+)?(\S+)\s*")


class Term(NamedTuple):
    """A score of a filter."""

    filter: str
    score: str


class Comparison(NamedTuple):
    """A score against a number, or against another times a factor."""

    left: Term
    relation: str
    right: Term | float
    factor: float = 1.0


def parse_term(text: str) -> Term:
    """Read ``FILTER.SCORE``.

    Raises:
        ConfigError: it is none.
    """
    match = _TERM.fullmatch(text)
    if match is None:
        raise ConfigError(
            f"found {text!r}, expected FILTER.SCORE with a score that begins with one of "
            f"{list(HEADS)}, e.g. kalman.rmse.position"
        )
    return Term(match["filter"], match["score"])


def parse_condition(text: str) -> tuple[Comparison, ...]:
    """Read a condition; all of its comparisons have to hold.

    Raises:
        ConfigError: it cannot be understood.
    """
    comparisons = []
    for part in text.split(" and "):
        sides = _COMPARISON.fullmatch(part)
        if sides is None:
            raise ConfigError(
                f"found {part.strip()!r}, expected FILTER.SCORE <= NUMBER (or <, >, >=, or "
                "[NUMBER *] another FILTER.SCORE), with spaces around the signs"
            )
        left, relation, factor, right = sides.groups()
        if factor is not None and not _NUMBER.fullmatch(factor):
            raise ConfigError(f"found the factor {factor!r}, expected a number")
        bound = float(right) if _NUMBER.fullmatch(right) else parse_term(right)
        comparisons.append(Comparison(parse_term(left), relation, bound, float(factor or 1)))
    return tuple(comparisons)
