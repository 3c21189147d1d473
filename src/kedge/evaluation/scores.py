"""What a filter's run over a log is worth, as types; see :mod:`kedge.evaluation.record`.

What is None, or an empty mapping by default, was not there to be scored, and is left out of
``summary.json``; NaN is a score that came out undefined, and becomes null there.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from kedge.evaluation.trajectory import Statistics


class Score(NamedTuple):
    """A figure with its 95 % confidence interval, NaN where none is known."""

    value: float
    lower: float = math.nan
    upper: float = math.nan

    def __format__(self, form: str) -> str:
        return format(self.value, form)


@dataclass(frozen=True)
class WhitenessScore:
    """Whether a sensor's innovations are uncorrelated in time."""

    lag_1: float
    """Autocorrelation of neighbouring innovations."""
    p_value: float
    white: bool


@dataclass(frozen=True)
class ResidualScore:
    """Residuals of one component of the readings of one target."""

    median: float
    spread: float
    """Standard deviation by the median of absolute deviations."""
    standardised: float
    """Median in predicted standard deviations."""


@dataclass(frozen=True)
class TargetScores:
    """Readings of one landmark, beacon or anchor."""

    readings: int
    gated: int
    residuals: Mapping[str, ResidualScore] = field(metadata={"inline": True})
    """By component of the measurement."""


@dataclass(frozen=True)
class SensorScores:
    """What became of one sensor's readings."""

    readings: int
    verdicts: Mapping[str, int]
    """How many readings met which verdict."""
    fused: float | None = None
    """Share of the readings that was used."""
    nis: float | None = None
    """Mean normalised innovation squared of the fused readings."""
    nis_dof: float | None = None
    """What it is on average if the model is right."""
    off_by: float | None = None
    """How far off its readings are, in what the rig expects: by medians, of all that were
    judged."""
    log_likelihood: float | None = None
    """Sum over the fused readings."""
    whiteness: WhitenessScore | None = None
    targets: Mapping[str, TargetScores] = field(default_factory=dict)


@dataclass(frozen=True)
class EffectiveSize:
    """Of a cloud of particles, before it is resampled."""

    min: float
    median: float


@dataclass(frozen=True)
class Silence:
    """When a sensor was not heard for longer than its rig allows."""

    allowed: float
    """In s."""
    stretches: tuple[tuple[float, float], ...]
    """From when to when, in s."""
    seconds: float


@dataclass(frozen=True)
class Refusals:
    """When a sensor's readings were nothing but outliers for long."""

    stretches: tuple[tuple[float, float], ...]
    """From when to when, in s."""
    longest: float
    """In s."""
    recovered: tuple[float, ...]
    """When a reading was let in for that, in s."""


@dataclass(frozen=True)
class ClippedControl:
    """A component of the control that was commanded beyond what the vehicle can do."""

    limit: float
    commands: int
    """How often it was commanded anew and lay beyond."""
    seconds: float
    """For how long."""
    largest: float


@dataclass(frozen=True)
class HealthScores:
    """What a filter had to do to keep its belief usable."""

    repairs: int
    """Covariances that were not positive semi-definite and had to be projected, and clouds of
    particles that stood in too few places and had to be widened."""
    recoveries: int
    """How often the gates were opened after they refused everything."""
    smallest_eigenvalue: float | None = None
    """The least of all correlation matrices; below 0 one is no covariance."""
    effective_size: EffectiveSize | None = None
    resampled: int | None = None
    depleted: int | None = None
    """Readings that no particle explained."""
    collapsed: int | None = None
    """Readings after which one particle carried nearly all the weight."""
    refusals: Mapping[str, Refusals] = field(default_factory=dict)
    """By sensor."""
    silences: Mapping[str, Silence] = field(default_factory=dict)
    """By sensor."""
    clipped_controls: Mapping[str, ClippedControl] = field(default_factory=dict)
    """By component."""


@dataclass(frozen=True)
class FilterScores:
    """One filter over one recorded log. Errors, NEES and paths need truth."""

    sensors: Mapping[str, SensorScores]
    health: HealthScores
    std: Mapping[str, float]
    """By field, the median over time of the 1-sigma that the filter believes in."""
    singular: float
    """Share of the steps at which the covariance is singular, so that there is no NEES."""
    fits: bool = True
    """Whether the readings of every sensor lie about where the rig expects them."""
    astray: Mapping[str, float] = field(default_factory=dict)
    """Augmented states that end over 3 sigma from where the rig believes them, in sigma."""
    rmse: Mapping[str, Score] = field(default_factory=dict)
    """By field and component, in SI units."""
    nees: float | None = None
    """Mean normalised estimation error squared."""
    nees_dof: int | None = None
    """What it is on average if the covariance is right."""
    nees_by_field: Mapping[str, float] = field(default_factory=dict)
    coverage_95: Mapping[str, float] = field(default_factory=dict)
    """By field, the share of errors inside the 95 % bound."""
    samples: int | None = None
    """Output times at which truth is known."""
    ape: Mapping[str, Statistics] = field(default_factory=dict)
    """Absolute position error (m), without alignment and after the best rigid one."""
    rpe: Mapping[str, Statistics] = field(default_factory=dict)
    """Relative position error (m) over 1 m and 10 m of the path."""
    distance: float | None = None
    """Length of the true path, in m."""
    final_error: float | None = None
    """In m."""
    final_error_of_distance: float | None = None
    seconds: float | None = None
    """Of computing, without compiling."""
    microseconds_per_event: float | None = None
    ratio_to_baseline: float | None = None
    """Of the position's RMSE to that of dead reckoning."""
    digest: str | None = None
    """SHA-256 of means, covariances and verdicts."""


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from."""

    command: str
    arguments: tuple[str, ...]
    """As typed."""
    version: str
    """Of kedge."""
    title: str
    runs: int
    notes: tuple[str, ...]
    """What the readers of the files had to say."""
    warnings: tuple[str, ...]
    """What should be known before the figures are trusted."""
    configuration: Mapping[str, Any]
    """The resolved rig or scenario."""
    digest: Mapping[str, str]
    """SHA-256 of inputs, configuration and result."""
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    """Of the libraries that compute, and of the compiler."""
    platform: str | None = None


@dataclass(frozen=True)
class LogSummary:
    """``summary.json`` of ``kedge estimate``, ``compare`` and ``demo``."""

    about: Provenance = field(metadata={"inline": True})
    filters: Mapping[str, FilterScores]
    verdicts: Mapping[str, Mapping[str, Mapping[str, int]]]
    """By filter and sensor, how many readings met which verdict."""
    events: int
    duration: float
    """In s."""
