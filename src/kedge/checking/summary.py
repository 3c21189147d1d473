"""What a check found of a rig on a log, as types: what ``check.json`` and the page hold."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from kedge.evaluation.scores import Provenance


@dataclass(frozen=True)
class StreamScore:
    """When the readings of a sensor, or of one of its targets, came."""

    readings: int
    rate: float
    """In Hz."""
    jitter: float
    """In s."""
    longest_gap: float
    """In s."""
    gaps: int
    """Steps of more than three times the usual one."""


@dataclass(frozen=True)
class CoverageScore:
    """Readings that were held back, beside where they were expected."""

    inside: float
    """Share in the region that should hold 95 %."""
    stretches: int
    """How many predictions that is."""


@dataclass(frozen=True)
class SensorCheck:
    """What a log shows of one sensor."""

    readings: int
    verdict: str
    """In a sentence."""
    stream: StreamScore | None = None
    targets: Mapping[str, StreamScore] = field(default_factory=dict)
    noise_ratio: float | None = None
    """How far off readings are, in what was expected: the root of the median of NIS by that of
    chi-square."""
    lag_1: float | None = None
    """Autocorrelation of neighbouring residuals."""
    white: bool | None = None
    memory: float | None = None
    """s until the correlation of residuals has fallen to 1/e, where they are not white."""
    coverage: Mapping[str, CoverageScore] = field(default_factory=dict)
    """By seconds for which readings were held back, "for good" last."""
    unfit: tuple[tuple[float, float], ...] = ()
    """From when to when the model of it did not hold, in s."""


@dataclass(frozen=True)
class Finding:
    """One thing that a rig says and its log contradicts."""

    kind: str
    """scale, sign, clock, arm, noise, exchange, error, stuck, far or coverage."""
    subject: str
    """A sensor, "control" or "vehicle"."""
    text: str
    """In a sentence."""
    advice: str = ""
    """What to write into the rig."""
    value: float | None = None
    gain: float | None = None
    """Logarithm of the ratio of likelihoods, with it and without."""


@dataclass(frozen=True)
class Quantity:
    """How far a log lets a quantity be known that a rig says."""

    value: float
    std: float | None
    """None where the log does not tell of it."""


@dataclass(frozen=True)
class CheckSummary:
    """``summary.json`` of ``kedge check``."""

    about: Provenance = field(metadata={"inline": True})
    filters: Mapping[str, Any]
    """By sensor."""
    findings: tuple[Finding, ...]
    quantities: Mapping[str, Quantity]
    """What else the log tells of: clocks, scales, arms."""
    undetermined: tuple[str, ...]
    """Which quantities the log could not determine, and what would help."""
