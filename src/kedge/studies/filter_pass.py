"""One filter over a chunk of a study's runs: by machine code where it can be, else by XLA."""

import functools as ft
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import space_of
from kedge.estimation.compiled import Engine, compiled_pass
from kedge.estimation.log import Log, Schedule
from kedge.estimation.native import by_run
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.runs import joined, shared
from kedge.estimation.traced import Estimates, pass_over
from kedge.numerics.linalg import UNROLLED, UNROLLED_COLUMNS

PART = 8
"""Runs that XLA does at once, or a 16th of a large chunk: the cores share its parts, and bits
hang on the chunk alone."""


class Given(NamedTuple):
    """What a filter is given of runs; every leaf has a leading run axis."""

    mean: Any
    """Of its prior."""
    controls: Any
    readings: Any


class Rows(NamedTuple):
    """The events of which scores need something."""

    scored: Int[np.ndarray, " K"]
    sensed: Int[np.ndarray, " E"]


class Believed(NamedTuple):
    """What scores need of a run's estimates."""

    mean: Any
    """At the scored events."""
    cov: Float[Array, "*K n n"] | None
    """Of states that are small enough for a NEES."""
    verdict: Int[Array, "*E"]
    dof: Int[Array, "*E"]
    nis: Float[Array, "*E"] | None
    """Of measurements that are small enough."""


class FilterPass:
    """A filter's pass over chunks of runs of one size, compiled once.

    ``runs`` is how many there are in all chunks. Run i draws from ``fold_in(key, i)``.
    Machine code does each run by itself, whatever the chunk, so its bits are those of the run
    alone; XLA's hang on how many it does at once.
    """

    def __init__(
        self,
        filter: AbstractFilter,
        rig: Rig,
        schedule: Schedule,
        rows: Rows,
        key: PRNGKeyArray,
        engine: Engine = "auto",
        runs: int = 1,
    ):
        self._filter, self._rig, self._schedule = as_arrays((filter, rig, schedule))
        self._rows, self._key = rows, key
        self._engine: Engine = engine
        self._work = runs * len(schedule.time)
        self._native: Any = None
        self._lowered: Any = None
        self._program: Any = None
        self.compile_seconds = 0.0

    @property
    def is_ready(self) -> bool:
        """Whether it is compiled."""
        return self._program is not None

    @property
    def compiler(self) -> str:
        """Whose code it is, once it is checked: native or xla. Its bits hang on that."""
        return "xla" if self._native is None else "native"

    def check(self, given: Given) -> None:
        """Trace the pass over runs of these shapes.

        Raises:
            ContractError: the filter cannot run on the rig.
        """
        if self.is_ready or self._native is not None or self._lowered is not None:
            return
        begin = time.perf_counter()
        bare = Log(self._schedule, None, ())
        rig, log = _told(self._rig, bare, given)
        none, all_own = (
            jax.tree.map(lambda _: False, (self._filter, self._rig, bare)),
            jax.tree.map(lambda _: True, given),
        )
        flags = none[0], *_told(none[1], none[2], all_own)
        pick = _Pick(None, *_kept(rig))
        self._native = compiled_pass(
            self._filter, rig, log, False, self._engine, pick, flags, self._work
        )
        if self._native is None:
            rows = _parts(_runs(given))[0]
            self._lowered = _batch.lower(*self._arguments(_taken(given, rows), rows))
        self.compile_seconds += time.perf_counter() - begin

    def compile(self, given: Given) -> None:
        """Make it ready, so that the time of a pass is not that of compiling."""
        if self.is_ready:
            return
        self.check(given)
        begin = time.perf_counter()
        self._program = self._by_native if self._lowered is None else self._by_xla()
        if self._native is not None:
            self._program(given, np.arange(_runs(given)))  # compiles how results are read
        self.compile_seconds += time.perf_counter() - begin

    def over(self, given: Given, index: Int[np.ndarray, " runs"]) -> Believed:
        """What was believed in the runs of these numbers; leading run axis.

        Raises:
            ContractError: the filter cannot run on the rig.
        """
        self.compile(given)
        return self._program(given, index)

    def _by_native(self, given: Given, index: Int[np.ndarray, " runs"]) -> Believed:
        rig, log = _told(self._rig, Log(self._schedule, None, ()), given)
        raw = self._native.raw(self._filter, rig, log, len(index))
        beliefs = _Pick(None, *_kept(rig))(raw)
        # Waited for, since its memory is the next call's.
        return jax.block_until_ready(_by_run(beliefs, self._rows, len(index)))

    def _by_xla(self) -> Any:
        program, self._lowered = self._lowered.compile(), None

        def over(given: Given, index: Int[np.ndarray, " runs"]) -> Believed:
            parts = _parts(len(index))

            def part(number: int) -> Believed:
                some = _taken((given, index), parts[number])
                return jax.block_until_ready(program(*self._arguments(*some)))

            beliefs = joined(shared(part, range(len(parts))))
            return jax.tree.map(lambda leaf: leaf[: len(index)], beliefs)

        return over

    def _arguments(self, given: Given, index: Int[np.ndarray, " runs"]) -> tuple[Any, ...]:
        known = self._filter, self._rig, self._schedule, self._rows
        return *known, given, index, self._key


class _Pick(eqx.Module):
    """Picks what scores need, of all events or of some."""

    rows: Rows | None
    cov: bool = eqx.field(static=True)
    nis: bool = eqx.field(static=True)

    def __call__(self, estimates: Estimates) -> Believed:
        moments, outcome = estimates.moments, estimates.outcome
        scored, sensed = (slice(None),) * 2 if self.rows is None else self.rows
        return Believed(
            mean=jax.tree.map(lambda leaf: leaf[scored], moments.mean),
            cov=moments.cov[scored] if self.cov else None,
            verdict=outcome.verdict[sensed],
            dof=outcome.dof[sensed],
            nis=outcome.nis[sensed] if self.nis else None,
        )


def _kept(rig: Rig) -> tuple[bool, bool]:
    """Whether covariances and NIS are kept: those that XLA forms without a loop."""
    widest = max((s.sensor.dof() for s in rig.sensors), default=0)
    return space_of(type(rig.prior.mean)).size <= UNROLLED_COLUMNS, widest <= UNROLLED


def _told(rig: Any, log: Log, given: Given) -> tuple[Any, Log]:
    """A rig and a log with what is a run's own."""
    known = eqx.tree_at(lambda r: r.prior, rig, Gaussian(given.mean, rig.prior.cov))
    return known, Log(log.schedule, given.controls, given.readings)


def _runs(given: Given) -> int:
    return jax.tree.leaves(given)[0].shape[0]


def _parts(runs: int) -> list[Int[np.ndarray, " part"]]:
    """Rows of equally many runs each; the last run fills up what is left over."""
    count = -(-runs // max(PART, runs // 16))
    size = -(-runs // count)
    return list(np.minimum(np.arange(count * size), runs - 1).reshape(count, size))


def _taken(tree: Any, rows: Int[np.ndarray, " part"]) -> Any:
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _many(
    filter: AbstractFilter,
    rig: Rig,
    schedule: Schedule,
    rows: Rows,
    given: Given,
    index: Int[Array, " runs"],
    key: PRNGKeyArray,
) -> Believed:
    pick = _Pick(rows, *_kept(rig))

    def one(run: Int[Array, ""], given: Given) -> Believed:
        known, log = _told(rig, Log(schedule, None, ()), given)
        return pick(pass_over(filter, known, log, jr.fold_in(key, run), False)[0])

    return jax.vmap(one)(index, given)


_batch: Any = eqx.filter_jit(_many)


@eqx.filter_jit
def _by_run(raw: Believed, rows: Rows, runs: int) -> Believed:
    """Some rows of what machine code left, by run; one program for all filters of a study."""

    def some(rows: Any, leaf: Any) -> Any:
        return by_run(leaf[:, rows], runs)

    return Believed(
        mean=jax.tree.map(ft.partial(some, rows.scored), raw.mean),
        cov=None if raw.cov is None else some(rows.scored, raw.cov),
        verdict=some(rows.sensed, raw.verdict),
        dof=some(rows.sensed, raw.dof),
        nis=None if raw.nis is None else some(rows.sensed, raw.nis),
    )
