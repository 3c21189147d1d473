"""The driver over logs and runs: where compilers attach, and where the cores share the work."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Int, PRNGKeyArray

from kedge.compiler.kernel import cores
from kedge.core.contracts import AbstractFilter
from kedge.estimation.compiled import Engine, compiled_pass
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig
from kedge.estimation.traced import Estimates, pass_over

Given = tuple[AbstractFilter, Rig, Log]
"""What a pass is over; parameters must be arrays."""
Keep = Callable[[Estimates], Any] | None
"""What is returned of the estimates, picked in the compiled program; None: all of them."""


class Runner:
    """A filter's pass over one log, or over runs of one schedule, compiled once.

    ``given`` is an example of what it is for. ``per_run`` is a tree of flags like it: which
    arrays have a leading axis of runs; without it there is one log. Machine code does it where
    it can, each run by itself, so that its bits are those of the run alone; XLA does
    ``at_once`` runs at most, and its bits hang on that. ``work`` is how many events there will
    be in all: see :func:`~kedge.estimation.compiled.compiled_pass`.

    A log alone draws from ``key``, run i from ``fold_in(key, i)``.

    Raises:
        ContractError: the engine asked for cannot run this.
    """

    def __init__(
        self,
        given: Given,
        key: PRNGKeyArray | None = None,
        keep: Keep = None,
        *,
        history: bool = False,
        per_run: Any = None,
        engine: Engine = "auto",
        work: int = 0,
        at_once: int = 1,
    ):
        before = time.perf_counter()
        self._native = compiled_pass(*given, history, engine, keep, per_run, work)
        self._lowered: Any = None
        self._program: Any = _passed
        self._options = jr.key(0) if key is None else key, keep, history
        self._keep, self._per_run, self._at_once = keep, per_run, at_once
        self.is_ready = False
        """Whether it is compiled."""
        self.compile_seconds = time.perf_counter() - before

    @property
    def compiler(self) -> str:
        """Whose code it is: native or xla. Its bits hang on that."""
        return "xla" if self._native is None else "native"

    def trace(self, given: Given, index: Int[np.ndarray, " runs"] | None = None) -> None:
        """Trace the pass over logs of these shapes.

        Raises:
            ContractError: the filter cannot run on the rig.
        """
        if self._native is None and self._lowered is None and not self.is_ready:
            before = time.perf_counter()
            rows = None if index is None else parts(len(index), self._at_once)[0]
            self._lowered = _passed.lower(*self._arguments(given, index, rows))
            self.compile_seconds += time.perf_counter() - before

    def compile(self, given: Given, index: Int[np.ndarray, " runs"] | None = None) -> None:
        """Make it ready, so that the time of a pass is not that of compiling.

        Raises:
            ContractError: the filter cannot run on the rig.
        """
        if self.is_ready:
            return
        self.trace(given, index)
        before = time.perf_counter()
        if self._native is None:
            self._program, self._lowered = self._lowered.compile(), None
        elif index is not None:
            self.over_runs(given, index)  # compiles how results are read
        self.is_ready = True
        self.compile_seconds += time.perf_counter() - before

    def over(self, given: Given) -> tuple[Any, Any]:
        """What is kept of the estimates of one log, and the history if it was asked for."""
        return self.bound(given)()

    def bound(self, given: Given) -> Callable[[], tuple[Any, Any]]:
        """The same as a call, with all that it needs at hand."""
        if self._native is None:
            arguments = self._arguments(given, None, None)
            return lambda: self._program(*arguments)
        call = self._native.bound(given)

        def kept() -> tuple[Any, Any]:
            estimates, history, _ = call()
            return estimates if self._keep is None else _picked(self._keep, estimates), history

        return kept

    def over_runs(self, given: Given, index: Int[np.ndarray, " runs"]) -> Any:
        """What is kept of the estimates of the runs of these numbers; leading run axis."""
        count = len(index)
        if self._native is not None:
            # It reads plain memory, so that a part needs no copy, and uses all cores by itself.
            given = jax.tree.map(np.asarray, given)
            most = self._native.most_runs(given)
            some = [slice(begin, min(begin + most, count)) for begin in range(0, count, most)]
            return joined([self._by_native(self._rows(given, rows), rows) for rows in some])
        rows = parts(count, self._at_once)

        def part(number: int) -> Any:
            arguments = self._arguments(given, index, rows[number])
            return jax.block_until_ready(self._program(*arguments)[0])

        # What is not compiled yet, the first call compiles.
        first = [] if self.is_ready else [part(0)]
        with ThreadPoolExecutor(cores()) as pool:  # outside Python's lock
            returned = joined([*first, *pool.map(part, range(len(first), len(rows)))])
        return jax.tree.map(lambda leaf: leaf[:count], returned)

    def _by_native(self, given: Given, rows: slice) -> Any:
        return self._native.over_runs(given, rows.stop - rows.start, self._keep)

    def _rows(self, given: Given, rows: Any) -> Given:
        """Some of the runs."""

        def taken(leaf: Any, of_run: bool) -> Any:
            return leaf[rows] if of_run else leaf

        return jax.tree.map(taken, given, self._per_run)

    def _arguments(self, given: Given, index: Any, rows: Any) -> tuple[Any, ...]:
        """What XLA's program is called with, for a log alone or for some of the runs."""
        if index is not None:
            given, index = self._rows(given, rows), index[rows]
        split = eqx.partition(given, False if self._per_run is None else self._per_run)
        return *split, index, *self._options


def parts(runs: int, most: int) -> list[Int[np.ndarray, " part"]]:
    """Rows of equally many runs each, at most so many; the last run fills up the last part."""
    count = -(-runs // most)
    size = -(-runs // count)
    return list(np.minimum(np.arange(count * size), runs - 1).reshape(count, size))


def joined(parts: Sequence[Any]) -> Any:
    """Trees of arrays, one after the other along the first axis."""
    if len(parts) == 1:
        return parts[0]
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


@eqx.filter_jit
def _picked(keep: Callable[[Estimates], Any], estimates: Estimates) -> Any:
    return keep(estimates)


def _pass(
    of_run: Any,
    common: Any,
    index: Int[Array, " runs"] | None,
    key: PRNGKeyArray,
    keep: Keep,
    history: bool,
) -> tuple[Any, Any]:
    """XLA's program, with what is a run's own apart from what all share."""

    def one(of_run: Any, key: PRNGKeyArray) -> tuple[Any, Any]:
        filter, rig, log = eqx.combine(of_run, common)
        estimates, past = pass_over(filter, rig, log, key, history)
        return estimates if keep is None else keep(estimates), past

    if index is None:
        return one(of_run, key)
    return jax.vmap(lambda run, of_run: one(of_run, jr.fold_in(key, run)))(index, of_run)


_passed: Any = eqx.filter_jit(_pass)
