"""Studies: many filters over the same simulated runs, chunk by chunk.

Every filter sees the same truths and readings. The draws of run i come from the seed, the name
of a stream and i, so another filter, another number of runs, another chunk, engine or machine
changes none.
"""

import dataclasses
import time
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Int, PRNGKeyArray

from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ConfigError, ContractError
from kedge.core.manifolds import space_of
from kedge.estimation.compiled import Engine
from kedge.estimation.rig import as_arrays
from kedge.estimation.runner import Given, Runner
from kedge.simulation.loop import start_near
from kedge.simulation.scenario import LoopFilter, Scenario
from kedge.simulation.simulate import Simulation, simulate
from kedge.studies.measure import given_of, per_run, pick_of, scored
from kedge.studies.scores import Part, Result, RunScores, Tally, chunks_of
from kedge.studies.study import Plan, Study

CHUNK = 16
"""Runs in one batch."""
PART = 8
"""Runs that XLA does at once, or a 16th of a large chunk: the cores share its parts, and bits
hang on the chunk alone."""


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
        self.plan = study.plan
        self._scenarios = {name: as_arrays(study.scenario_of(name)) for name in filters}
        self._models = as_arrays(self.filters)
        self._runners: dict[str, Runner] = {}

    @property
    def chunks(self) -> range:
        """The numbers of the chunks."""
        return range(chunks_of(self.runs, self.chunk))

    def prepare(self) -> None:
        """Trace every filter's program, so that one that cannot run is known before any has.

        Raises:
            ContractError: a filter cannot run on the rig.
        """
        index, shapes = np.arange(self.chunk), None
        for name in self.filters:
            self.progress(f"{name}: checking")
            try:
                if shapes is None or self.study.scenario.each_in_its_loop:
                    shapes = eqx.filter_eval_shape(lambda n=name: self._truths(n, index))
                blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
                given = self._given(name, *blank)
                self._runner(name, given).trace(given, index)
            except ContractError as error:
                raise ContractError(f"filter {name!r} cannot run here: {error}") from error

    def part(self, number: int) -> Part:
        """Simulate the runs of a chunk, and run every filter over each.

        Raises:
            ContractError: a filter cannot run on the rig.
        """
        begin = number * self.chunk
        index, end = np.arange(begin, begin + self.chunk), min(begin + self.chunk, self.runs)
        stage = f"runs {begin + 1} to {end} of {self.runs}"
        pieces, first, truth, means = {}, None, None, None
        for name in self.filters:
            if truth is None or self.study.scenario.each_in_its_loop:
                self.progress(f"{stage}: simulating")
                truth, means = self._truths(name, index)
            shown_truth = ({}, {}) if number else _first(self.study.scenario, self.plan, truth)
            first = first or shown_truth
            kept = np.arange(self.chunk) < end - begin
            given = jax.block_until_ready(self._given(name, truth, means))
            runner, compiling = self._runner(name, given), 0.0
            if not runner.is_ready:
                self.progress(f"{name}: compiling")
                runner.compile(given, index)
                compiling = runner.compile_seconds
            self.progress(f"{name}: {stage}")
            before = time.perf_counter()
            beliefs = runner.over_runs(given, index)
            seconds = time.perf_counter() - before
            judged = scored(self._scenarios[name], self.plan, truth, beliefs, kept)
            settled, whole, apart, sums, example = jax.tree.map(np.asarray, judged)
            cut = slice(0, end - begin)
            settled, whole, *windows = (
                RunScores(*(leaf[cut] for leaf in s)) for s in (settled, whole, *apart.values())
            )
            pieces[name] = Result(
                runs=settled,
                whole=whole,
                sums=sums,
                seconds=seconds,
                compile_seconds=compiling,
                compiler=runner.compiler,
                example=example._asdict() if number == 0 else {},
                track=shown_truth[0],
                windows=dict(zip(apart, windows, strict=True)),
            )
        return Part(pieces, *(first or ()))

    def tally(self) -> Tally:
        """Every chunk, added up.

        Raises:
            ContractError: a filter cannot run on the rig.
        """
        self.prepare()
        tally = Tally(list(self.filters))
        for number in self.chunks:
            tally.add(self.part(number))
        return tally

    def _runner(self, name: str, given: Given) -> Runner:
        """Who runs a filter; in a loop of its own by the compiler that steers it."""
        if name not in self._runners:
            engine: Engine = "xla" if self.study.scenario.feedback == "filter" else "auto"
            self._runners[name] = Runner(
                given,
                stream(self.study.seed, f"filter {name}"),
                pick_of(given, self.plan),
                per_run=per_run(given),
                engine=engine,
                work=self.runs * len(self.plan.log.schedule.time),
                at_once=max(PART, self.chunk // 16),
            )
        return self._runners[name]

    def _given(self, name: str, truth: Simulation, means: Any) -> Given:
        """Runs as a filter is told of them; what is a run's own has a leading run axis."""
        return given_of(self._models[name], self._scenarios[name], self.plan, truth, means)

    def _truths(self, name: str, index: Int[np.ndarray, " runs"]) -> tuple[Simulation, Any]:
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
        return _simulated(
            as_arrays(scenario), jnp.asarray(index), stream(seed, "truth"), priors, draws
        )


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
    return Trials(study, filters, runs, chunk, progress).tally().results()


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
