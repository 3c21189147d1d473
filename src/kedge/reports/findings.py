"""What a report says in words: the headline, the facts below it, and its warnings."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from kedge.core.manifolds import space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Recording
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.by_target import targets_off
from kedge.evaluation.health import concerns
from kedge.evaluation.plausibility import FAR
from kedge.evaluation.score import Run
from kedge.reports import style
from kedge.reports.drawing import without_fused
from kedge.reports.figures import main_field
from kedge.reports.maps import rivals

# Shares of errors inside the 95 % bound, beyond which a run does not know how good it is.
HONEST, CAUTIOUS = 0.85, 0.99
UNTRUSTED = "these results are not to be trusted"
USED = 0.9
"""Share of a sensor's readings; where fewer are fused, it is said why."""
BROKEN = Verdict.UNKNOWN_TARGET, Verdict.NOT_FINITE, Verdict.BAD_COVARIANCE
NAMED = 5  # targets that are off; more are in the table


def principal(runs: Sequence[Run]) -> Run:
    """The run that the report is about: the first that is neither baseline nor smoother."""
    filters = [run for run in runs if not style.is_baseline(run.name)]
    online = [run for run in filters if not style.is_smoother(run.name)]
    return [*online, *filters, *runs][0]


def baseline(runs: Sequence[Run]) -> Run | None:
    """The run that the others have to beat, if there is one."""
    return next((run for run in runs if style.is_baseline(run.name)), None)


def headline(runs: Sequence[Run], recording: Recording) -> str:
    """The result in one sentence."""
    run, seconds = principal(runs), _seconds(recording)
    if run.errors is None:
        known = f"{_spread(run)}, {_shares(run)} over {seconds}\u00a0s"
        return f"{run.name}: {known}; no truth to judge by."
    field, cut = main_field(run.errors)
    factor, unit = style.shown(run.errors.units[cut.start])

    def rms(other: Run) -> str:
        value, *ends = (factor * number for number in other.scores.rmse[field])
        return f"{style.measured(value, ends)[0]}\u00a0{unit}"

    parts = [
        f"{run.name}: {rms(run)} rms {style.words(field)} error over {seconds}\u00a0s",
        f"{style.percent(inside(run))} of the errors inside the 95\u00a0% bound",
    ]
    later = [other for other in runs if style.is_smoother(other.name) and other is not run]
    parts += [f"{other.name} {rms(other)}" for other in later[:1] if other.errors]
    other = baseline(runs)
    if other is not None and other is not run and other.errors is not None:
        parts.append(f"{style.words(other.name.replace('-', ' '))} {rms(other)}")
    return "; ".join(parts) + "."


def facts(runs: Sequence[Run], recording: Recording) -> list[tuple[str, str]]:
    """The strip below the headline: name and value."""
    run = principal(runs)
    readings, fused = _readings(run)
    lines = [("duration", f"{_seconds(recording)} s")]
    if (distance := driven(run)) is not None:
        lines.append(("distance driven", f"{style.number(distance)} m"))
    lines.append(("readings", style.count(readings)))
    if readings:
        lines.append(("fused", style.percent(fused / readings)))
        gaps = [end - start for start, end in without_fused(run)]
        if gaps:
            lines.append(("longest without a reading", f"{style.number(max(gaps), 2)} s"))
    if (spent := cost(run, recording)) is not None:
        lines.append(("time per event", f"{style.number(spent, 2)} µs"))
    return lines


def warnings(runs: Sequence[Run], recording: Recording, rig: Rig) -> list[str]:
    """What a reader should know before trusting the numbers."""
    lines = [no_nees(r.name, share) for r in rivals(runs) if (share := r.scores.singular)]
    lines += [text for run in rivals(runs) for text in _misfits(run)]
    judged = [run for run in rivals(runs) if run.errors is not None]
    for word, wrong in (
        ("Over-confident", lambda share: share < HONEST),
        ("Over-cautious", lambda share: share > CAUTIOUS),
    ):
        names = [f"{r.name} ({style.percent(inside(r))})" for r in judged if wrong(inside(r))]
        if names:
            lines.append(
                f"{word}, by the share of errors in the 95\u00a0% bound: {', '.join(names)}."
            )
    if judged and (errors := judged[0].errors):
        missing = 1 - (judged[0].scores.samples or 0) / len(errors.time)
        if missing > 0.01:
            lines.append(f"Truth is unknown at {style.percent(missing)} of the output times.")
    for run in rivals(runs):
        verdicts = sum((Counter(s.verdicts) for s in run.scores.sensors.values()), Counter())
        lines += concerns(run.name, run.scores.health, verdicts)
    run = principal(runs)
    for off in targets_off(run.scores, units_of(rig))[:NAMED]:
        factor, symbol = style.shown(off.unit)
        lines.append(
            f"{off.sensor}: {off.target} is off by {style.number(factor * off.median, 2)} "
            f"{symbol} in {style.words(off.component)} (median of its residuals, "
            f"{style.number(off.standardised, 2)} of what it may scatter by)."
        )
    online = [run for run in rivals(runs) if not style.is_smoother(run.name)] or [run]
    return lines + [
        text
        for run in online
        for installation in rig.sensors
        for text in _used(run, installation)
    ]


def _misfits(run: Run) -> list[str]:
    """Sensors whose readings are not where the rig expects them, and quantities gone astray."""
    if style.is_smoother(run.name):
        return []
    lines = [
        f"{run.name}: {sensor}: readings are {style.number(entry.off_by, 2)} times further off "
        f"than claimed; {UNTRUSTED}. kedge check looks for what is wrong."
        for sensor, entry in run.scores.sensors.items()
        if entry.off_by is not None and entry.off_by > FAR
    ]
    return lines + [
        f"{run.name}: {name} ends {style.number(abs(off), 2)} standard deviations from where "
        "the rig believes it: it may stand for an error of something else."
        for name, off in run.scores.astray.items()
    ]


def _used(run: Run, installation: Installation) -> list[str]:
    """How much of a sensor's readings went into the estimate, where that is a surprise."""
    entry, gate = run.scores.sensors[installation.name], installation.gate
    counts, readings, sensor = entry.verdicts, entry.readings, installation.name
    if entry.fused is None:
        return [f"{run.name}: {sensor} has no readings in this log."]
    if entry.fused < USED:
        number = counts.get(Verdict.FUSED.name, 0)
        used = f"only {style.percent(entry.fused)} of" if number else "none of"
        return [
            f"{run.name}: {used} the {style.count(readings)} readings of {sensor} were used: "
            f"{refusals(counts)}."
        ]
    texts = []
    alarms = counts.get(Verdict.GATED.name, 0) / readings
    if gate is not None and alarms > max(5 * gate, 0.02):
        texts.append(
            f"{run.name}: the gate of {sensor} refused {style.percent(alarms)} of the "
            f"readings, {style.percent(gate)} is what it is set to."
        )
    broken = {v.name: n for v in BROKEN if (n := counts.get(v.name, 0))}
    if broken:
        number = style.count(sum(broken.values()))
        texts.append(
            f"{run.name}: {number} of {style.count(readings)} readings of {sensor} were not "
            f"used: {refusals(broken)}."
        )
    return texts


def refusals(verdicts: Mapping[str, int]) -> str:
    """How many readings were not used, by reason: "12 gated, 3 unknown target"."""
    return ", ".join(
        f"{style.count(number)} {style.words(name.lower())}"
        for name, number in sorted(verdicts.items(), key=lambda item: -item[1])
        if name != Verdict.FUSED.name
    )


def no_nees(name: str, singular: float) -> str:
    """That nothing is known of a filter's honesty, and why."""
    share = style.percent(singular)
    return f"{name}: no NEES: the covariance is singular in {share} of the steps."


def said(warnings: Sequence[str]) -> list[str]:
    """Warnings for a console or a file: with the spaces of a keyboard."""
    return [re.sub("[\u00a0\u202f]", " ", text) for text in warnings]


def units_of(rig: Rig) -> dict[str, dict[str, str]]:
    """By sensor over a map, the unit of each component of its measurement."""
    units = {}
    for installation in rig.sensors:
        if installation.targets is not None:
            measured = space_of(installation.sensor.measures)
            units[installation.name] = dict(zip(measured.labels, measured.units, strict=True))
    return units


def duration(recording: Recording) -> float:
    """From the log's start to its last event, in s."""
    return float(np.asarray(recording.log.schedule.time)[-1])


def driven(run: Run) -> float | None:
    """Length of the true path, else of the estimated one; none without a position."""
    if run.scores.distance is not None:
        return run.scores.distance
    if not hasattr(run.track.mean, "position"):
        return None
    steps = np.diff(np.asarray(run.track.mean.position), axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def inside(run: Run) -> float:
    """Share of the errors of the main field in their 95 % bound."""
    return run.scores.coverage_95[main_field(run.errors)[0]] if run.errors else np.nan


def cost(run: Run, recording: Recording) -> float | None:
    """Time per event in microseconds, if the run was timed."""
    seconds = run.scores.seconds
    return None if seconds is None else 1e6 * seconds / len(recording.stamps)


def _seconds(recording: Recording) -> str:
    whole = duration(recording)
    return style.count(round(whole)) if whole >= 20 else style.number(whole)


def _readings(run: Run) -> tuple[int, int]:
    entries = run.scores.sensors.values()
    fused = (entry.verdicts.get(Verdict.FUSED.name, 0) for entry in entries)
    return sum(entry.readings for entry in entries), sum(fused)


def _shares(run: Run) -> str:
    readings, fused = _readings(run)
    share = style.percent(fused / readings) if readings else ""
    return f"{share} of {style.count(readings)} readings fused" if readings else "no readings"


def _spread(run: Run) -> str:
    """How well the run believes to know its main field, in the middle of the log."""
    states = space_of(type(run.track.mean))
    name = "position" if "position" in states.slices() else next(iter(states.slices()))
    cut = states.slices()[name]
    factor, unit = style.shown(states.units[cut.start])
    middle = style.number(factor * run.scores.std[name], 2)
    return f"{style.words(name)} known to {middle}\u00a0{unit} (median standard deviation)"
