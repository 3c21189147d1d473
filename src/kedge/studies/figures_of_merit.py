"""What a study's filters are worth, as types: the tree behind its ``summary.json``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from kedge.evaluation.scores import Provenance, Score


@dataclass(frozen=True)
class WindowScores:
    """Over some of the times of all runs that came out finite; intervals are over the runs."""

    rmse: Mapping[str, Score]
    """By field and component, in SI units."""
    nees: Score
    """Mean normalised estimation error squared; null where a covariance is singular."""
    singular: float
    """Share of the times at which the covariance is singular, so that there is no NEES."""
    nis: Mapping[str, Score]
    """By sensor, mean normalised innovation squared of what was fused."""
    nis_dof: Mapping[str, float]
    """What it is on average if the model is right."""
    outlying: Mapping[str, float]
    """By sensor, the share of readings that a gate refused or a robust loss weighed down."""
    coverage_95: Score
    """Share of times at which the truth lay in the 95 % ellipsoid."""
    within_3_sigma: Mapping[str, Score]
    """Share of times within 3 standard deviations; of a field that of its worst component."""
    tracking: Mapping[str, Score] = field(default_factory=dict)
    """Root mean squares of what the scenario's world watches."""
    ratios: Mapping[str, Score] = field(default_factory=dict)
    """Of errors to those of the baseline over the same runs, by bootstrap over the runs."""
    nis_per_dof: float | None = None
    """Of all sensors together."""
    seconds_per_run: float | None = None
    """Of a window: its share of the events that are scored, times the time of a whole run."""


@dataclass(frozen=True)
class MeansOverTime:
    """Means over times of what the runs have at each: a bad time adds no more than its own."""

    rmse: Mapping[str, float]
    ratio: Mapping[str, float]
    """To that of the baseline."""


@dataclass(frozen=True)
class PublishedScore:
    """What somebody else published of this filter."""

    rmse: float
    source: str


@dataclass(frozen=True)
class StudyScores:
    """One filter of a study."""

    score: Score
    """By which filters are judged."""
    score_of: str
    """What it is of: a field, or "time-mean-rms"."""
    settled: WindowScores = field(metadata={"inline": True})
    """After the burn-in."""
    time_mean_rms: Score
    """Mean over time of the root mean square over the components."""
    nees_dof: int
    """What NEES is on average if the covariance is right."""
    all_steps: WindowScores
    """Without a burn-in."""
    runs: int
    failed: int
    """Runs that came out not finite, and are left out."""
    seconds: float
    """Of the filter's passes over all runs, without compiling."""
    seconds_per_run: float
    compile_seconds: float
    compiler: str
    """Whose code did the passes: native, xla, or both."""
    baseline: str
    """The filter that the others are compared with."""
    ratio_to_baseline: Score
    by_time: MeansOverTime
    dominated_by: int = 0
    """How many filters of the study are at least as accurate and as fast, and not equal."""
    windows: Mapping[str, WindowScores] = field(default_factory=dict)
    """By the scenario's named stretches of time."""
    published: PublishedScore | None = None


@dataclass(frozen=True)
class Headline:
    """The score by which filters are judged."""

    name: str
    """"pooled" or "time-mean-rms"."""
    of: str


@dataclass(frozen=True)
class QuotedFigure:
    """A figure from the scenario's source beside the same score here."""

    score: str
    value: float
    source: str
    here: Score


@dataclass(frozen=True)
class ExpectedFigure:
    """Where a score should lie, and whether it does."""

    score: str
    between: Sequence[float]
    source: str
    verdict: str
    figures: str
    """That decide it."""


@dataclass(frozen=True)
class JudgedClaim:
    """What somebody states, and whether it stands."""

    text: str
    source: str
    test: str
    means: str
    verdict: str
    figures: str
    """That decide it."""


@dataclass(frozen=True)
class StudySummary:
    """``summary.json`` of ``kedge study`` and ``kedge merge``."""

    about: Provenance = field(metadata={"inline": True})
    source: str
    """Of the scenario."""
    score: Headline
    filters: Mapping[str, StudyScores]
    quoted: tuple[QuotedFigure, ...] = ()
    expected: tuple[ExpectedFigure, ...] = ()
    claims: tuple[JudgedClaim, ...] = ()
    errata: tuple[str, ...] = ()
    """Of the scenario's source."""
