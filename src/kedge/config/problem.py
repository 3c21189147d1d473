"""From a rig file and a log to what a filter runs on: rig, recording, truth, provenance."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int, Int64

from kedge.config.building import (
    build_installation,
    build_prior,
    build_rig,
    build_sensor,
    build_vehicle,
)
from kedge.config.mounts import with_mounts
from kedge.config.questions import odd_log
from kedge.config.readings import (
    keep_targets,
    map_of,
    read_controls,
    read_readings,
)
from kedge.config.rigs import RigConfig, load_rig_config
from kedge.config.standing import with_standing
from kedge.config.truth import check_overlap, pose_at, pose_table, reference_of, truth_of
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.errors import ConfigError, DataError
from kedge.core.manifolds import charts_of
from kedge.core.registry import vehicles
from kedge.datasets.fetch import log_of
from kedge.estimation.clipping import clipped, sentences
from kedge.estimation.log import SECOND, Recording, Stamped, Truth, assemble
from kedge.estimation.rig import Rig, check_step
from kedge.evaluation.glitches import LONGEST, without_glitches
from kedge.evaluation.truth import judged_at
from kedge.formats.logs import RawLog, digest_inputs
from kedge.formats.readers import read_log

MOST_OUTPUTS = 5e6
"""More estimates than this in one log is a wrong stamp rather than a long drive."""
SILENCE = 2.0  # s without a control that a user should hear of


class Source(NamedTuple):
    """Where a sensor's readings come from, in the order of its readings."""

    stamps: Int64[np.ndarray, " n"]
    """ns, as stamped: later than the event by the sensor's latency."""
    targets: list[str] | None
    lines: Int[np.ndarray, " n"]
    """Line of each reading in the source's file."""


class Problem(NamedTuple):
    """A rig and a log, put together."""

    title: str
    config: dict[str, Any]
    """The resolved rig file."""
    rig: Rig
    recording: Recording
    truth: Truth | None
    filter: str
    sources: dict[str, Source]
    """By sensor."""
    target_names: dict[str, tuple[str, ...]]
    """By sensor over a map, the ids of its targets."""
    notes: list[str]
    """What was left out or changed on the way."""
    inputs_digest: str


def load_problem(
    rig: str | RigConfig,
    log: str,
    truth: str = "auto",
    until: float | None = None,
    overrides: Mapping[str, str] | None = None,
) -> Problem:
    """Read a rig and a log and fit them together.

    Args:
        rig: a shipped rig's name or a TOML file, or one that is read already.
        log: PATH or PATH#PART, or a data set's name in place of the path.
        truth: "auto" for the log's own, "none", or a source to compare with. The prior's
            ``from_truth`` takes it even if nothing is compared.
        until: stop this many seconds after the start.
        overrides: dotted key of the rig -> value as TOML.

    Raises:
        KedgeError: a file cannot be used, or rig and log do not fit; one line for each mistake.
    """
    config = rig if isinstance(rig, RigConfig) else load_rig_config(rig, overrides)
    return fitted(config, read_raw(config, log), log, truth, until)


def read_raw(config: RigConfig, log: str) -> RawLog:
    """The log as it was recorded.

    Raises:
        KedgeError: it cannot be read, or the rig cannot be built whatever stands in it.
    """
    build_vehicle(config)  # what does not fit is said before a long file is read
    return read_log(log_of(log), config.format, config.bag, config.map_origin)


def fitted(
    config: RigConfig, raw: RawLog, log: str, truth: str = "auto", until: float | None = None
) -> Problem:
    """A rig and a log that was read: see :func:`load_problem`; messages call it ``log``.

    Estimation starts at the first control, without one at the first reading; later if the
    prior needs a true pose that comes later. What is before is left out and counted.

    Raises:
        KedgeError: they do not fit.
    """
    if config.standing is not None:
        raw = with_standing(config.standing, raw, config.origin)
    bare, vehicle = build_vehicle(_placed(config, raw), raw.maps)
    notes = list(raw.notes)
    config = with_mounts(config, raw, set(charts_of(type(vehicle.start()))), notes)
    reference = reference_of(raw, truth)
    control_stamps, controls = read_controls(config, raw, bare, notes)
    plain = {name: build_sensor(config, name, raw.maps) for name in config.sensors}
    stamped, sources = {}, {}
    for name, sensor in config.sensors.items():
        table = keep_targets(config, raw, name, notes)
        stamped[name] = read_readings(
            config, raw, name, table, type(plain[name]).measures, notes
        )
        column = sensor.target or "target"
        targets = table.texts[column] if sensor.map else None
        sources[name] = Source(table.stamps, targets, table.lines)

    notes += odd_log(control_stamps, {n: s.stamps for n, s in sources.items()}, reference)
    events = [source.stamps for source in stamped.values()]
    every = np.concatenate([control_stamps, *events])
    if len(every) == 0:
        raise DataError(f"{log}: empty log: found no control and no reading")
    start = int(control_stamps[0]) if len(control_stamps) else int(every.min())
    poses = None
    if config.prior.from_truth:
        poses = pose_table(config, raw, reference)
        check_overlap(poses, start, int(every.max()))
        if poses.stamps[0] > start:
            late, start = (int(poses.stamps[0]) - start) / SECOND, int(poses.stamps[0])
            notes.append(f"{poses.name} begins {late:.3g} s late; the estimate starts with it")
    end = int(every.max())
    if until is not None:
        if not 0 < until < np.inf:
            raise DataError(f"until: found {until:g} s, expected a time above 0")
        end = min(end, start + round(until * SECOND))

    _check_span(config, log, start, end, sources)
    notes += _silences(control_stamps, end)

    for name in stamped:
        inside = (stamped[name].stamps >= start) & (stamped[name].stamps <= end)
        early = int((stamped[name].stamps < start).sum())
        if early:
            notes.append(f"{name}: {early} readings before the start were left out")
        stamped[name], sources[name] = _cut(stamped[name], sources[name], inside)

    known = {}
    if poses is not None:
        charts = charts_of(type(vehicle.start()))
        for field in config.prior.from_truth:
            known[field] = pose_at(poses, field, charts[field], start)
    built = _rig_of(config, bare, vehicle, plain, known)
    true, wrong, judged = None, 0, None
    if reference is not None:
        true, wrong = without_glitches(truth_of(config, reference, bare, start, end))
        judged = judged_at(true, start, end, config.output.rate)
    recording = assemble(
        start, end, control_stamps, controls, list(stamped.values()), config.output.rate, judged
    )
    longest = float(np.diff(recording.stamps, prepend=start).max()) / SECOND
    rate = f"output.rate = {config.output.rate:g} Hz"
    check_step(vehicle, longest, f"{config.origin}: the longest step between events ({rate})")
    notes += sentences(clipped(recording, vehicle))
    if judged is not None:
        notes.append(f"truth: it is sparse; scores are those at its own {len(judged)} stamps")
    if wrong:
        notes.append(
            f"truth: {wrong} samples jump away and back (glitches of at most {LONGEST:g} s); "
            "they are left out of scores"
        )
    return Problem(
        title=raw.title or config.title,
        config=config.model_dump(mode="json", exclude_none=True),
        rig=built,
        recording=recording,
        truth=true,
        filter=config.filter.name,
        sources=sources,
        target_names={
            name: map_of(config, name, raw.maps).ids
            for name, spec in config.sensors.items()
            if spec.map is not None
        },
        notes=notes,
        inputs_digest=digest_inputs(raw),
    )


def rig_of(config: RigConfig) -> Rig:
    """A rig as its file alone describes it, without a log.

    Raises:
        ConfigError: its prior or a map comes from the log.
        ContractError: vehicle, sensors and prior do not fit together.
    """
    if config.prior.from_truth:
        raise ConfigError(
            f"{config.origin}: prior.from_truth takes {', '.join(config.prior.from_truth)} "
            "from the truth of a log: read both together with kedge.load(rig, log)"
        )
    bare, vehicle = build_vehicle(config, {})
    plain = {name: build_sensor(config, name, {}) for name in config.sensors}
    return _rig_of(config, bare, vehicle, plain, {})


def _rig_of(
    config: RigConfig,
    bare: AbstractVehicle,
    vehicle: AbstractVehicle,
    plain: Mapping[str, AbstractSensor],
    known: Mapping[str, Any],
) -> Rig:
    prior = build_prior(config, bare, vehicle, known)
    installed = tuple(build_installation(config, name, plain[name]) for name in plain)
    return build_rig(config, vehicle, installed, prior)


def _placed(config: RigConfig, raw: RawLog) -> RigConfig:
    """The rig, with what the log knows of its place if the vehicle asks for it."""
    known = {field.name for field in dataclasses.fields(vehicles.get(config.vehicle.model))}
    place = {name: value for name, value in raw.place.items() if name in known}
    vehicle = config.vehicle.model_copy(
        update={"parameters": place | config.vehicle.parameters}
    )
    placed = config.model_copy(update={"vehicle": vehicle})
    placed._origin = config.origin
    return placed


def _check_span(
    config: RigConfig, log: str, start: int, end: int, sources: Mapping[str, Source]
) -> None:
    """Refuse a log shorter than one output, and one that a wrong stamp makes endless.

    Raises:
        DataError: with the source and line of the last stamp.
    """
    if end <= start:
        raise DataError(
            f"{log}: all of it happens at one time, {start} ns; expected a duration"
        )
    count = int((end - start) * config.output.rate / SECOND)
    if count < 1:
        raise DataError(
            f"{log}: found {(end - start) / SECOND:g} s, expected at least one period of the "
            f"output, {1 / config.output.rate:g} s (output.rate = {config.output.rate:g} Hz)"
        )
    if count > MOST_OUTPUTS:
        late = [(int(s.stamps[-1]), name, s) for name, s in sources.items() if len(s.stamps)]
        where = "the last stamp is of the control"
        if late and max(late, key=lambda entry: entry[0])[0] >= end:
            stamp, name, source = max(late, key=lambda entry: entry[0])
            where = f"the last stamp, {stamp} ns, is of {name}, line {int(source.lines[-1])}"
        raise DataError(
            f"{log}: found {(end - start) / SECOND:.0f} s, which at output.rate = "
            f"{config.output.rate:g} Hz are {count:.2g} estimates, expected at most "
            f"{MOST_OUTPUTS:.0e}; {where}"
        )


def _silences(control_stamps: Int64[np.ndarray, " n"], end: int) -> list[str]:
    """What to say of a control that stops: the last one is held, which may not be true."""
    if len(control_stamps) == 0:
        return []
    gaps = np.diff(np.append(control_stamps, end)) / SECOND
    long = int((gaps[:-1] > SILENCE).sum())
    notes = [f"control: {long} gaps of more than {SILENCE:g} s; the last is held"] * bool(long)
    if len(gaps) > 2 and (usual := float(np.median(gaps[:-1]))) > SILENCE:
        notes.append(
            f"control: its usual step is {usual:g} s; if that is wrong, its stamps are of "
            "another unit (time_unit)"
        )
    if gaps[-1] > SILENCE:
        notes.append(f"control: it ends {gaps[-1]:.1f} s before the log; the last is held")
    return notes


def _cut(
    stamped: Stamped, source: Source, inside: Bool[np.ndarray, " n"]
) -> tuple[Stamped, Source]:
    rows = np.flatnonzero(inside)
    readings = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[rows]), stamped.readings)
    targets = None if source.targets is None else [source.targets[row] for row in rows]
    return Stamped(stamped.stamps[rows], readings), Source(
        source.stamps[rows], targets, source.lines[rows]
    )
