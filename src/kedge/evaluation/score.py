"""What a run was worth: its errors, the honesty of its covariance, the fate of the readings."""

import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from kedge.core.beliefs import Gaussian
from kedge.core.errors import DataError
from kedge.core.manifolds import Chart, charts_of, space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates
from kedge.estimation.clipping import clipped
from kedge.estimation.log import SECOND, Recording, Truth
from kedge.estimation.rig import Rig
from kedge.evaluation.attitudes import angles_of
from kedge.evaluation.by_target import target_scores
from kedge.evaluation.consistency import coverage, mean_interval, nees, singular, whiteness
from kedge.evaluation.health import health
from kedge.evaluation.plausibility import FAR, astray, off_by
from kedge.evaluation.refusals import refusals
from kedge.evaluation.scores import (
    ClippedControl,
    FilterScores,
    Score,
    SensorScores,
    WhitenessScore,
)
from kedge.evaluation.silences import silences
from kedge.evaluation.trajectory import (
    Statistics,
    Trajectory,
    absolute_pose_error,
    align,
    associate,
    relative_pose_error,
    umeyama,
)
from kedge.evaluation.truth import longest_gap, truth_at


class Track(NamedTuple):
    """An estimate at the output times, on the host."""

    time: Float[np.ndarray, " K"]
    """s since the log's start."""
    stamps: Any
    """The same times, exact, in ns."""
    mean: Any
    """The state, every leaf with a leading time axis."""
    cov: Float[np.ndarray, "K n n"]


class Errors(NamedTuple):
    """Truth minus estimate in tangent coordinates, for the fields that truth knows."""

    time: Float[np.ndarray, " K"]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    error: Float[np.ndarray, "K k"]
    """NaN where truth is unknown."""
    cov: Float[np.ndarray, "K k k"]
    """The estimate's covariance of these components."""
    fields: dict[str, slice]


class Run(NamedTuple):
    """One filter's work on one log."""

    name: str
    """What the user typed, e.g. ``particle:count=5000``."""
    estimates: Estimates
    track: Track
    errors: Errors | None
    """None without truth."""
    scores: FilterScores


def track_of(
    estimates: Estimates, recording: Recording, events: Int[np.ndarray, " K"] | None = None
) -> Track:
    """The estimate at the times at which it was asked for, or after other ``events``.

    Raises:
        DataError: it is not finite; the message says from when on.
    """
    at = recording.outputs if events is None else events
    mean = jax.tree.map(lambda leaf: np.asarray(leaf)[at], estimates.moments.mean)
    cov = np.asarray(estimates.moments.cov)[at]
    time = np.asarray(estimates.time)[at]
    leaves = [*jax.tree.leaves(mean), cov]
    finite = np.all([np.isfinite(v).reshape(len(time), -1).all(axis=1) for v in leaves], axis=0)
    if not finite.all():
        raise DataError(f"the estimate is not finite from {time[np.argmin(finite)]:.3f} s on")
    return Track(time, recording.stamps[at], mean, cov)


def at_truth(estimates: Estimates, recording: Recording) -> Track:
    """The estimate where it is compared: at the outputs, or at the stamps of a sparse truth.

    Raises:
        DataError: it is not finite; the message says from when on.
    """
    if recording.judged is None:
        return track_of(estimates, recording)
    track = track_of(estimates, recording, recording.judged)
    # As truth counts its time, to the bit: 32-bit floats would be beside it.
    return track._replace(time=(track.stamps - recording.start) / SECOND)


def errors_of(track: Track, truth: Truth, max_gap: float | int | None = None) -> Errors:
    """Compare a track with truth, interpolated in each field's chart."""
    states = space_of(type(track.mean))
    cuts, charts = states.slices(), dict(zip(states.cls._fields, states.charts, strict=True))
    true, covered = truth_at(truth, track.time, charts, max_gap)
    columns, fields, picked, start = [], {}, [], 0
    for name, values in true.items():
        chart = charts[name]
        columns.append(_minus(chart, values, np.asarray(getattr(track.mean, name))))
        fields[name] = slice(start, start + chart.size)
        picked += range(cuts[name].start, cuts[name].stop)
        start += chart.size
    error = np.concatenate(columns, axis=1)
    error[~covered] = np.nan
    return Errors(
        track.time,
        tuple(states.labels[i] for i in picked),
        tuple(states.units[i] for i in picked),
        error,
        track.cov[:, picked][:, :, picked],
        fields,
    )


def score(
    name: str,
    estimates: Estimates,
    recording: Recording,
    rig: Rig,
    truth: Truth | None = None,
    targets: Mapping[str, tuple[str, ...]] | None = None,
) -> Run:
    """Score one run: its errors, the honesty of its covariance, the fate of its readings.

    ``targets`` are the names of the targets by sensor; without them they go by number.
    """
    track = track_of(estimates, recording)
    beyond = clipped(recording, rig.vehicle)
    sensors = _sensor_scores(estimates, recording, rig, targets or {})
    last = Gaussian(jax.tree.map(lambda leaf: leaf[-1], track.mean), track.cov[-1])
    scores = FilterScores(
        sensors=sensors,
        health=replace(
            health(estimates),
            refusals=refusals(estimates, recording, rig),
            silences=silences(estimates, recording, rig),
            clipped_controls={n: ClippedControl(**entry) for n, entry in beyond.items()},
        ),
        std=_deviations(track),
        singular=singular(track.cov),
        fits=all((entry.off_by or 0.0) <= FAR for entry in sensors.values()),
        astray=astray(rig, last, float(track.time[-1])),
    )
    if truth is None:
        return Run(name, estimates, track, None, scores)
    judged = at_truth(estimates, recording)
    truth = in_the_map(truth, judged)
    errors = errors_of(judged, truth)
    scores = _with_errors(scores, errors, _spatial_errors(judged, truth, errors))
    if "position" in errors.fields:
        scores = _with_path(scores, judged, truth)
    return Run(name, estimates, track, errors, scores)


def in_the_map(truth: Truth, track: Track) -> Truth:
    """A truth in a frame of its own moved onto a track, by the best rigid motion.

    Only positions are moved, and orientations left out: what is left to compare is the shape.
    Of a vehicle that stood, no motion can be found: then the truth stays where it is, with a
    warning.

    Raises:
        DataError: truth has no position, or the two do not overlap.
    """
    if not truth.own_frame:
        return truth
    if "position" not in truth.fields or not hasattr(track.mean, "position"):
        raise DataError("truth in a frame of its own needs positions to be moved by")
    known = Trajectory(truth.time, truth.fields["position"])
    estimate, true = associate(
        Trajectory(track.time, track.mean.position), known, longest_gap(truth.time)
    )
    try:
        known = umeyama(true.position, estimate.position, False).apply(known)
    except DataError as error:
        warnings.warn(
            f"the truth has a frame of its own that cannot be found ({error}): the errors are "
            "those without alignment",
            stacklevel=2,
        )
    return Truth(truth.time, {"position": known.position})


def _minus(chart: Chart, true: np.ndarray, mean: np.ndarray) -> Float[np.ndarray, "K c"]:
    return np.array(jax.jit(jax.vmap(chart.boxminus))(true, mean))


def _with_errors(
    scores: FilterScores, errors: Errors, others: Mapping[str, Float[np.ndarray, " K"]]
) -> FilterScores:
    """RMSE with autocorrelation-aware intervals, NEES and coverage, per field and component.

    ``others`` are squared errors of which only the RMSE is wanted, by name.
    """
    known = ~np.isnan(errors.error).any(axis=1)
    if not known.any():
        raise DataError("truth covers none of the output times")
    rmse, share, mean_nees = {}, {}, {}
    for field, cut in errors.fields.items():
        squared = np.sum(errors.error[:, cut] ** 2, axis=1)
        rmse[field] = _root_mean(squared)
        inside = coverage(errors.error[known][:, cut], errors.cov[known][:, cut, cut])
        share[field] = float(inside)
        mean_nees[field] = float(
            jnp.mean(nees(errors.error[known][:, cut], errors.cov[known][:, cut, cut]))
        )
        if cut.stop - cut.start > 1:
            for index in range(cut.start, cut.stop):
                label = errors.labels[index]
                rmse[label] = _root_mean(errors.error[:, index] ** 2)
    whole = np.asarray(nees(errors.error[known], errors.cov[known]))
    return replace(
        scores,
        rmse=rmse | {name: _root_mean(squared) for name, squared in others.items()},
        nees=float(whole.mean()),
        nees_dof=errors.error.shape[1],
        nees_by_field=mean_nees,
        singular=singular(errors.cov[known]),
        coverage_95=share,
        samples=int(known.sum()),
    )


def _root_mean(squared: Float[np.ndarray, " K"]) -> Score:
    mean = mean_interval(squared)
    return Score(*np.sqrt(np.maximum([mean.mean, mean.lower, mean.upper], 0.0)).tolist())


def _with_path(scores: FilterScores, track: Track, truth: Truth) -> FilterScores:
    """APE and RPE in the convention of evo, and the final error as a share of the path."""
    turn = "heading" if truth.fields["position"].shape[1] == 2 else "attitude"
    known = turn in truth.fields and hasattr(track.mean, turn)
    estimate, true = associate(
        Trajectory(
            track.time, track.mean.position, getattr(track.mean, turn) if known else None
        ),
        Trajectory(truth.time, truth.fields["position"], truth.fields[turn] if known else None),
        longest_gap(truth.time),
    )
    absolute: dict[str, Statistics] = {}
    relative: dict[str, Statistics] = {}
    for kind in ("none", "rigid"):
        try:
            ape = absolute_pose_error(align(estimate, true, kind), true)
        except DataError:  # one spot or one line fixes no alignment
            continue
        absolute[kind] = ape.translation
    for metres in (1.0, 10.0):
        try:
            rpe = relative_pose_error(estimate, true, metres, "metres", "truth")
        except DataError:  # the vehicle did not drive so far
            continue
        relative[f"{metres:g}_m"] = rpe.translation
    steps = np.linalg.norm(np.diff(true.position, axis=0), axis=1)
    distance = float(steps.sum())
    final = float(np.linalg.norm(estimate.position[-1] - true.position[-1]))
    return replace(
        scores,
        ape=absolute,
        rpe=relative,
        distance=distance,
        final_error=final,
        final_error_of_distance=final / distance if distance > 0 else None,
    )


def _spatial_errors(
    track: Track, truth: Truth, errors: Errors
) -> dict[str, Float[np.ndarray, " K"]]:
    """Squared errors in plan where there is a height, of the heading of an attitude."""
    squared = {}
    where = errors.fields.get("position")
    if where is not None and where.stop - where.start == 3:
        squared["horizontal"] = np.sum(errors.error[:, where][:, :2] ** 2, axis=1)
    if "attitude" in errors.fields and "heading" not in errors.fields:
        charts = dict(charts_of(type(track.mean)))
        true, _ = truth_at(truth, track.time, {"attitude": charts["attitude"]})
        gap = angles_of(true["attitude"]).heading - angles_of(track.mean.attitude).heading
        unknown = np.isnan(errors.error[:, errors.fields["attitude"]]).any(axis=1)
        squared["heading"] = np.where(unknown, np.nan, np.angle(np.exp(1j * gap)) ** 2)
    return squared


def _deviations(track: Track) -> dict[str, float]:
    """How well each field is believed to be known: the median over time of its 1-sigma.

    Of a vector it is the root of the sum of variances; an attitude has the heading's beside it.
    """
    states, std = space_of(type(track.mean)), {}
    for name, cut in states.slices().items():
        variances = np.trace(track.cov[:, cut, cut], axis1=1, axis2=2)
        std[name] = float(np.median(np.sqrt(variances)))
    if (cut := states.slices().get("attitude")) is not None:
        angles = angles_of(track.mean.attitude, track.cov[:, cut, cut])
        std["heading"] = float(np.median(angles.std[0]))
    return std


def _sensor_scores(
    estimates: Estimates, recording: Recording, rig: Rig, names: Mapping[str, tuple[str, ...]]
) -> dict[str, SensorScores]:
    """Per sensor: verdict counts, NIS against its expectation, whiteness of the innovations."""
    outcome = jax.tree.map(np.asarray, estimates.outcome)
    sensor = np.asarray(recording.log.schedule.sensor)
    row = np.asarray(recording.log.schedule.row)
    scores = {}
    for index, installation in enumerate(rig.sensors):
        mine = np.flatnonzero(sensor == index)
        verdicts = Counter(Verdict(int(v)).name for v in outcome.verdict[mine])
        fused = mine[outcome.verdict[mine] == Verdict.FUSED]
        size = space_of(installation.sensor.measures).size
        entry = SensorScores(
            len(mine),
            dict(sorted(verdicts.items())),
            fused=len(fused) / len(mine) if len(mine) else None,
            off_by=off_by(outcome.nis[mine], outcome.dof[mine]),
            whiteness=_whiteness(outcome.white[fused][:, :size]),
        )
        if len(fused):
            entry = replace(
                entry,
                nis=float(outcome.nis[fused].mean()),
                nis_dof=float(outcome.dof[fused].mean()),
                log_likelihood=float(outcome.log_likelihood[fused].sum()),
            )
        if installation.targets is not None and len(mine):
            target = np.asarray(recording.log.readings[index].target)[row[mine]]
            numbers = tuple(map(str, range(installation.targets)))
            ids = names.get(installation.name, numbers)
            labels = space_of(installation.sensor.measures).labels
            by_target = target_scores(outcome, mine, target, ids, labels)
            entry = replace(entry, targets=by_target)
        scores[installation.name] = entry
    return scores


def _whiteness(white: Float[np.ndarray, "f m"]) -> WhitenessScore | None:
    lags = min(20, len(white) - 1)
    if lags < 1 or not (np.nansum(white**2, axis=0) > 0).all():
        return None
    test = whiteness(white, lags)
    return WhitenessScore(float(test.autocorrelation[0]), test.p_value, bool(test.white))
