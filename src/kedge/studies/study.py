"""Studies: many filters over the same simulated runs, chunk by chunk.

Every filter sees the same truths and readings. The draws of run i come from the seed, the name
of a stream and i, so another filter, another number of runs, another chunk, engine or machine
changes none.
"""

import dataclasses
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Int, PRNGKeyArray

from kedge.core.contracts import AbstractFilter, AbstractVehicle
from kedge.core.errors import ConfigError, ContractError
from kedge.core.manifolds import space_of
from kedge.core.registry import unknown
from kedge.estimation.compiled import Engine
from kedge.estimation.log import SECOND
from kedge.estimation.rig import Rig, as_arrays
from kedge.simulation.loop import start_near
from kedge.simulation.scenario import LoopFilter, Scenario
from kedge.simulation.simulate import Simulation, schedule, simulate
from kedge.studies.filter_pass import FilterPass, Rows
from kedge.studies.measure import Plan, Window, given_of, scored
from kedge.studies.scores import (
    Part,
    Piece,
    Result,
    RunScores,
    Tally,
    chunks_of,
)
from kedge.vehicles.undriven import Undriven

CHUNK = 16
"""Runs in one batch."""
SCORES = ("pooled", "time-mean-rms")
STARTS = ("prior", "truth")


class Study(NamedTuple):
    r"""A scenario, and how it is scored.

    ``score`` "pooled" is the root of the mean, over runs and times, of the squared error of a
    field, at the end of every step: $\sqrt{\overline{\lVert e \rVert^2}}$. "time-mean-rms" is
    the mean over runs and analysis times (after the readings of a time are taken in) of the
    root mean square over the state's components, $\overline{\lVert e \rVert / \sqrt n}$: the
    "rmse.a" of the data-assimilation literature.

    ``start`` "prior" gives filters the prior as it is; with "truth" its mean is the true state
    at time 0 plus an error drawn from its covariance.

    ``vehicles`` are the motion models of filters, by name, that have not the rig's. Where a
    guidance listens to each filter in turn, every filter has a truth of its own, with the same
    draws; each is scored in the loop that it closes.

    Filters are judged by ``field`` of the state: its position or whatever comes first, if none
    is named.
    """

    scenario: Scenario
    burn_in: float | int = 0.0  # s
    score: str = "pooled"
    start: str = "prior"
    seed: int = 0
    vehicles: Mapping[str, AbstractVehicle] = {}
    field: str = ""
    windows: Mapping[str, Sequence[Sequence[float]]] = {}
    """Stretches of time (from, to; s) that are scored apart, by name."""

    def check(self) -> None:
        """Refuse what cannot be run.

        Raises:
            ConfigError: an option is unknown or out of range, or no time is left to score.
        """
        for name, known in (("score", SCORES), ("start", STARTS)):
            if (value := getattr(self, name)) not in known:
                raise ConfigError(f"{name}: found {value!r}, expected one of {list(known)}")
        fields = type(self.scenario.rig.prior.mean)._fields
        if self.field and self.field not in fields:
            raise ConfigError(
                f"field: {unknown('field of the state', self.field, list(fields))}"
            )
        if not 0 <= self.seed < 2**63:
            raise ConfigError(f"seed: found {self.seed}, expected 0 or more, below 2^63")
        if not 0 <= self.burn_in < self.scenario.duration:
            raise ConfigError(
                f"burn_in: found {self.burn_in:g} s, expected 0 or more and less than the "
                f"duration, {self.scenario.duration:g} s"
            )

    def scenario_of(self, name: str) -> Scenario:
        """The scenario as a filter knows it: with its own motion model, if it has one.

        Raises:
            ContractError: that model has another state or control than the rig's.
        """
        rig, model = self.scenario.rig, self.vehicles.get(name)
        if model is None:
            return self.scenario
        given, known = (type(vehicle.nominal_control(0.0)) for vehicle in (rig.vehicle, model))
        if not known._fields:
            model = Undriven(model, rig.vehicle)
        elif given is not known:
            raise ContractError(
                f"filter {name!r}: its {type(model).__name__} is driven by {known._fields}, "
                f"but the rig's {type(rig.vehicle).__name__} by {given._fields}"
            )
        changed = Rig(model, rig.sensors, rig.prior)
        return dataclasses.replace(self.scenario, rig=changed)


def stream(seed: int, name: str) -> PRNGKeyArray:
    """The key of all runs' draws for one purpose; that of run i is ``fold_in(key, i)``."""
    return jr.fold_in(jr.key(seed), np.uint32(zlib.crc32(name.encode())))


class Trials:
    """A study's runs in chunks, each of which can be computed by itself, anywhere.

    A filter's own draws come from the stream named after its key in ``filters``. A filter is
    compiled once; the last chunk is filled up with runs that are dropped.

    Raises:
        ConfigError: there are no runs, or nothing to score.
    """

    def __init__(
        self,
        study: Study,
        filters: Mapping[str, AbstractFilter],
        runs: int,
        chunk: int = CHUNK,
        progress: Callable[[str], None] = lambda text: None,
    ):
        study.check()
        for name, number in (("runs", runs), ("chunk", chunk)):
            if number < 1:
                raise ConfigError(f"{name}: found {number}, expected 1 or more")
        self.study, self.filters, self.runs = study, dict(filters), runs
        self.chunk, self.progress = min(chunk, runs), progress
        self.plan = plan_of(study)
        self._scenarios = {name: as_arrays(study.scenario_of(name)) for name in filters}
        self._passes = {name: self._pass(name) for name in filters}

    @property
    def chunks(self) -> range:
        """The numbers of the chunks."""
        return range(chunks_of(self.runs, self.chunk))

    def prepare(self) -> None:
        """Trace every filter's program, so that one that cannot run is known before any has.

        Raises:
            ContractError: a filter cannot run on the rig.
        """
        index, shapes = jnp.arange(self.chunk), None
        for name, filter_pass in self._passes.items():
            self.progress(f"{name}: checking")
            try:
                if shapes is None or self.study.scenario.each_in_its_loop:
                    shapes = eqx.filter_eval_shape(lambda n=name: self._truths(n, index))
                setting = self._scenarios[name], self.plan, *shapes
                given = eqx.filter_eval_shape(given_of, *setting)
                filter_pass.check(jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), given))
            except ContractError as error:
                raise ContractError(f"filter {name!r} cannot run here: {error}") from error

    def part(self, number: int) -> Part:
        """Simulate the runs of a chunk, and run every filter over each.

        Raises:
            ContractError: a filter cannot run on the rig.
        """
        begin = number * self.chunk
        index, end = jnp.arange(begin, begin + self.chunk), min(begin + self.chunk, self.runs)
        stage = f"runs {begin + 1} to {end} of {self.runs}"
        pieces, first, truth, means = {}, None, None, None
        for name in self.filters:
            if truth is None or self.study.scenario.each_in_its_loop:
                self.progress(f"{stage}: simulating")
                truth, means = self._truths(name, index)
            shown_truth = ({}, {}) if number else _first(self.study.scenario, self.plan, truth)
            first = first or shown_truth
            kept = jnp.arange(self.chunk) < end - begin
            setting = self._scenarios[name], self.plan, truth
            given, filter_pass = (
                jax.block_until_ready(given_of(*setting, means)),
                self._passes[name],
            )
            compiling = 0.0
            if not filter_pass.is_ready:
                self.progress(f"{name}: compiling")
                filter_pass.compile(given)
                compiling = filter_pass.compile_seconds
            self.progress(f"{name}: {stage}")
            before = time.perf_counter()
            believed = filter_pass.over(given, np.asarray(index))
            seconds = time.perf_counter() - before
            judged = scored(*setting, believed, kept)
            settled, whole, apart, sums, example = jax.tree.map(np.asarray, judged)
            cut = slice(0, end - begin)
            settled, whole, *windows = (
                RunScores(*(leaf[cut] for leaf in s)) for s in (settled, whole, *apart.values())
            )
            shown = example._asdict() if number == 0 else {}
            of_each = dict(zip(apart, windows, strict=True))
            pieces[name] = Piece(
                settled,
                whole,
                sums,
                seconds,
                compiling,
                filter_pass.compiler,
                shown,
                shown_truth[0],
                of_each,
            )
        return Part(pieces, *(first or ()))

    def _pass(self, name: str) -> FilterPass:
        """A filter's pass; in a loop of its own by the compiler that steers it."""
        rig, key = self.study.scenario_of(name).rig, stream(self.study.seed, f"filter {name}")
        rows = Rows(self.plan.events, self.plan.sensed)
        engine: Engine = "xla" if self.study.scenario.feedback == "filter" else "auto"
        schedule = self.plan.log.schedule
        return FilterPass(self.filters[name], rig, schedule, rows, key, engine, self.runs)

    def _truths(self, name: str, index: Int[Array, " runs"]) -> tuple[Simulation, Any]:
        """Simulate runs; if a guidance listens to each filter in turn, to the one named."""
        seed, scenario = self.study.seed, self.study.scenario
        pilot = scenario.loop_filter
        if scenario.each_in_its_loop:
            pilot = LoopFilter(self.filters[name], name)
        if pilot is not None:
            world = self.study.scenario_of(pilot.name)
            scenario = dataclasses.replace(world, loop_filter=pilot)
        priors = None if self.study.start == "prior" else stream(seed, "prior")
        draws = None if pilot is None else stream(seed, f"filter {pilot.name}")
        return _simulated(as_arrays(scenario), index, stream(seed, "truth"), priors, draws)


def run_study(
    study: Study,
    filters: Mapping[str, AbstractFilter],
    runs: int,
    progress: Callable[[str], None] = lambda text: None,
    chunk: int = CHUNK,
) -> dict[str, Result]:
    """Simulate ``runs`` runs, and run every filter over each, in this process.

    Of each run a few numbers are kept, of each time sums; see :class:`Trials`.

    Raises:
        ConfigError: there are no runs, or nothing to score.
        ContractError: a filter cannot run on the rig.
    """
    trials, tally = Trials(study, filters, runs, chunk, progress), Tally(list(filters))
    for number in trials.chunks:
        tally.add(trials.part(number))
    return tally.results()


def plan_of(study: Study) -> Plan:
    """The schedule and the events to score.

    Raises:
        ConfigError: nothing happens after the burn-in.
    """
    scenario = study.scenario
    pooled = study.score == "pooled"
    # Without outputs: their rate is so low that there is none.
    rate = 1 / scenario.dt if pooled else 0.5 / scenario.duration
    recording = schedule(scenario, rate)
    stamps, burn_in = recording.stamps, round(study.burn_in * SECOND)
    sensor = np.asarray(recording.log.schedule.sensor)
    if pooled:
        events = recording.outputs
    else:
        last = np.append(stamps[1:] != stamps[:-1], True)
        # Sensors that fire at one time stand together: the last of them is the analysis.
        events = np.flatnonzero((sensor >= 0) & (last | ~np.append(sensor[1:] >= 0, False)))
    settled = stamps[events] > burn_in
    if not settled.any():
        raise ConfigError(f"burn_in: nothing is scored after {study.burn_in:g} s")
    sensed = np.flatnonzero(sensor >= 0)
    ends = np.arange(1, scenario.steps + 1) * scenario.dt
    plan = Plan(
        log=recording.log,
        events=events,
        steps=np.round(stamps[events] / (scenario.dt * SECOND)).astype(np.int64) - 1,
        settled=settled,
        time=stamps[events] / SECOND,
        sensed=sensed,
        sensor=sensor[sensed],
        sensed_settled=stamps[sensed] > burn_in,
        sensed_time=stamps[sensed] / SECOND,
        steps_settled=ends > study.burn_in + 1e-9,
    )
    return plan._replace(windows=_windows(study, plan, ends))


def _windows(study: Study, plan: Plan, ends: np.ndarray) -> dict[str, Window]:
    """The windows in which something is scored, and the rest after the burn-in."""
    if not study.windows:
        return {}

    def inside(time: np.ndarray, spans: Sequence[Sequence[float]]) -> np.ndarray:
        return np.any([(time > a + 1e-9) & (time <= b + 1e-9) for a, b in spans], axis=0)

    times = plan.time, plan.sensed_time, ends
    windows = {
        name: Window(*(inside(time, spans) for time in times))
        for name, spans in study.windows.items()
    }
    settled = plan.settled, plan.sensed_settled, plan.steps_settled
    taken = (np.any(masks, axis=0) for masks in zip(*windows.values(), strict=True))
    windows["else"] = Window(*(a & ~b for a, b in zip(settled, taken, strict=True)))
    return {name: window for name, window in windows.items() if window.events.any()}


@eqx.filter_jit
def _simulated(
    scenario: Scenario,
    index: Int[Array, " runs"],
    truths: PRNGKeyArray,
    priors: PRNGKeyArray | None,
    draws: PRNGKeyArray | None,
) -> tuple[Simulation, Any]:
    """Truths with readings, and the means that the filters start from.

    Without a key for the priors, all start from the scenario's own. A filter in the loop has
    the start and the draws that it has outside.
    """
    prior = scenario.rig.prior
    states = space_of(type(prior.mean))

    def one(run: Int[Array, ""]) -> tuple[Simulation, Any]:
        white, world = None, scenario
        if priors is not None:
            white = jr.normal(jr.fold_in(priors, run), (states.size,))
        if scenario.loop_filter is not None and draws is not None:
            key = jr.fold_in(draws, run)
            pilot = dataclasses.replace(scenario.loop_filter, key=key, error=white)
            world = dataclasses.replace(scenario, loop_filter=pilot)
        truth = simulate(world, jr.fold_in(truths, run))
        mean = prior.mean if white is None else start_near(prior, truth.start, white)
        return truth, mean

    return jax.vmap(one)(index)


def _first(
    scenario: Scenario, plan: Plan, truth: Simulation
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Of the first run: the truth at the scored times, and readings of fields of the state."""
    path = {k: np.asarray(v)[0, plan.steps] for k, v in truth.truth._asdict().items()}
    seen = {}
    for installation, readings in zip(scenario.rig.sensors, truth.readings, strict=True):
        if installation.targets:  # it measures where its targets are, seen from the vehicle
            continue
        for field, values in readings.measurement._asdict().items():
            value = np.asarray(values)[0]
            if field in path and value.shape[1:] == path[field].shape[1:]:
                seen[f"{installation.name}.{field}"] = value
    return path, seen
