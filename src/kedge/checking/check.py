"""Is a rig honest on a log? Asked of its readings, without truth."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import bdtr

from kedge.checking.correlation import Memory, error_trial, is_clear, memory, noise_std
from kedge.checking.observability import Direction, undetermined
from kedge.checking.prediction import Coverage, coverage
from kedge.checking.program import Evaluated, Program, squares
from kedge.checking.search import Trial, hypotheses, tried
from kedge.checking.setting import Setting, changed, setting_of
from kedge.checking.streams import Judged, Span, Stream, judged, stream, stuck, unfit, without
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig
from kedge.estimation.transition import innermost, is_smoothable
from kedge.evaluation.plausibility import off_by
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.wrappers.hypotheses import Hypotheses
from kedge.tuning.tunable import tunables

MOST = 4
"""Hypotheses that are taken for true one after the other."""
FAR = 1.5
"""Times what is expected that readings may be off by without any being named."""
RARE = 1e-5
"""Probability of as few readings inside their region by chance, below which it is said."""
BULK = 0.8
"""Share in the region of 95 % from which on it is not worth a word."""


class Evidence(NamedTuple):
    """What a log shows of one sensor."""

    readings: int
    stream: Stream | None
    targets: Mapping[int, Stream]
    noise_ratio: float | None
    memory: Memory | None
    coverage: list[Coverage]
    stuck: list[Span]
    unfit: list[Span]
    far: bool = False
    """Whether readings are further off than claimed, and nothing explains it."""
    uncovered: Coverage | None = None
    """A horizon at which too few predictions hold, where nothing explains it."""


class Checked(NamedTuple):
    """All that a check found."""

    sensors: Mapping[str, Evidence]
    trials: Sequence[Trial]
    """What is wrong, the clearest first."""
    all_trials: Sequence[Trial]
    """Every hypothesis, as the rig stands."""
    directions: Sequence[Direction]
    setting: Setting
    """As it stands, without the readings of stuck sensors."""
    noise: Mapping[str, np.ndarray]
    """By sensor, the deviation of its white noise as the rig says."""

    @property
    def is_clean(self) -> bool:
        """Whether nothing was found."""
        odd = any(s.stuck or s.far or s.uncovered for s in self.sensors.values())
        return not self.trials and not odd


def check(
    filter: AbstractFilter,
    rig: Rig,
    recording: Recording,
    progress: Callable[[str], None] = lambda text: None,
) -> Checked:
    """Look for what in a rig its log contradicts.

    Each hypothesis (a scale, a sign, a clock, a lever arm, noise, targets exchanged, an error
    with a memory) is a pass over the log with the rig mended by it; one holds if it foresees
    the readings better by far, and throughout the log. The best is taken for true, and the
    others are tried again. In the place of a filter that draws random numbers, which would
    make gains out of chance, it is the extended one.

    Raises:
        DataError: no reading could be judged.
    """
    progress("compiling")
    filter = _without_draws(filter)
    noise = tuple(t for t in tunables(rig) if t.is_noise)
    setting = setting_of(rig, recording, noise)
    program = Program(filter, setting)
    base = program.evaluate(setting)
    if not np.isfinite(base.score).any():
        raise DataError("check: no reading could be judged; see the verdicts of kedge estimate")
    places = range(len(rig.sensors))
    still = {place: stuck(setting, base, place) for place in places}
    for place, spans in still.items():
        for _, rows in spans:
            setting = without(setting, place, rows)
    base = program.evaluate(setting) if any(still.values()) else base
    setting = setting._replace(square=squares(base, len(rig.sensors)))
    trials, tried_first, last, final = _rounds(filter, program, setting, base, progress)
    evidence = {}
    for place, installation in enumerate(rig.sensors):
        progress(f"{installation.name}: predictions")
        spans = [span for span, _ in still[place]]
        evidence[installation.name] = _evidence(program, setting, base, place, spans)
        if not trials and not any(still.values()):
            evidence[installation.name] = _unexplained(evidence[installation.name])
        fits = judged(last, final, place)
        evidence[installation.name] = evidence[installation.name]._replace(unfit=unfit(fits))
    progress("observability")
    typical = {
        s.name: noise_std(setting, base, place)
        for place, s in enumerate(rig.sensors)
        if (np.asarray(base.log.schedule.sensor) == place).any()
    }
    return Checked(evidence, trials, tried_first, undetermined(setting, base), setting, typical)


def _without_draws(filter: AbstractFilter) -> AbstractFilter:
    """The filter; the extended one for those that draw random numbers."""
    if isinstance(filter, Hypotheses):
        return filter
    drawn = isinstance(innermost(filter), AbstractEnsembleFilter) or not is_smoothable(filter)
    return ExtendedKalman() if drawn else filter


def _rounds(
    filter: AbstractFilter,
    program: Program,
    setting: Setting,
    base: Evaluated,
    progress: Callable[[str], None],
) -> tuple[list[Trial], list[Trial], Setting, Evaluated]:
    """What is wrong, the clearest first; all as first tried; the setting mended by them."""
    accepted: list[Trial] = []
    first: list[Trial] = []
    for number in range(MOST):
        progress(f"hypotheses, round {number + 1}")
        trials = [tried(program, setting, base, c) for c in hypotheses(setting, base)]
        first = first or trials
        holding = [trial for trial in trials if trial.holds]
        best = max(holding, key=lambda trial: trial.gain.total, default=None)
        mended = None if best is None else (best, program, changed(setting, best.change))
        for place in range(len(setting.rig.sensors)):
            hangs = memory(judged(setting, base, place))
            if hangs is None or not hangs.suspicious:
                continue
            progress(f"{setting.rig.sensors[place].name}: an error with a memory")
            remembering = error_trial(filter, setting, base, place)
            if remembering is not None and is_clear(
                remembering[0], None if mended is None else mended[0]
            ):
                mended = remembering
        if mended is None:
            break
        trial, program, setting = mended
        accepted.append(trial)
        base = program.evaluate(setting)
    return accepted, first, setting, base


def _evidence(
    program: Program, setting: Setting, base: Evaluated, place: int, spans: list[Span]
) -> Evidence:
    readings: Judged = judged(setting, base, place)
    schedule = base.log.schedule
    time = np.asarray(schedule.time)[np.asarray(schedule.sensor) == place]
    by_target = {
        int(target): entry
        for target in np.unique(readings.target)
        if setting.rig.sensors[place].targets
        and (entry := stream(readings.time[readings.target == target])) is not None
    }
    ratio = off_by(readings.nis, readings.dof)
    covered = coverage(program, setting, place) if len(readings.nis) else []
    hangs = memory(readings) if len(readings.nis) else None
    return Evidence(len(time), stream(time), by_target, ratio, hangs, covered, spans, [])


def _unexplained(evidence: Evidence) -> Evidence:
    """Marked where readings are not what was expected, and no hypothesis says why."""
    few = [
        entry
        for entry in evidence.coverage
        if np.isfinite(entry.horizon)
        and entry.inside < BULK
        and bdtr(round(entry.inside * entry.stretches), entry.stretches, 0.95) < RARE
    ]
    far = evidence.noise_ratio is not None and evidence.noise_ratio > FAR
    return evidence._replace(far=far, uncovered=few[0] if few else None)
