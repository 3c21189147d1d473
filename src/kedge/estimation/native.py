"""Traces the pass once for logs of any length, compiles it, and runs it over arrays."""

import functools as ft
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax.extend.core import Literal

from kedge.compiler.graph import Unsupported
from kedge.compiler.kernel import Kernel, cores, prepared
from kedge.compiler.program import SHORT, Argument, Limits, build
from kedge.compiler.values import kind_of
from kedge.core.contracts import AbstractFilter
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig
from kedge.estimation.traced import Estimates, whole_pass

ROWS = 2
"""In place of however many events or readings there are, while the program is traced."""
MOST_BYTES = 2**26
"""Of results that lie in memory as the machine code leaves them, before they are ordered."""

MUCH = 1_000_000
"""Events of all runs together from which a long program is worth compiling."""
LONG = Limits(scalars=400_000, lines=100_000)
"""Of a program for so many events.

A line takes LLVM longer to compile than XLA, and saves time at every event of every run: how
many of them it takes to pay does not depend on how many lines there are.
"""

Keep = Callable[[Estimates], Any] | None
Form = tuple[Any, tuple[tuple[tuple[int, ...], str], ...], tuple[bool, ...], bool]
"""What a program hangs on: the structure of its arguments, their shapes and types, which of
them are the log's, and whether the history is kept."""


class Traced(NamedTuple):
    """The traced program, and how it is called."""

    jaxpr: Any
    arguments: list[Argument]
    results: Any
    """Shapes of the results, for a log of :data:`ROWS` events."""


class NativePass:
    """A compiled pass: of one run, or of runs side by side that share a schedule."""

    def __init__(
        self,
        traced: Traced,
        per_run: Sequence[bool] | None,
        wanted: frozenset[int] | None,
        limits: Limits = SHORT,
    ):
        batched = per_run is not None
        flags = per_run or [False] * len(traced.arguments)
        arguments = [
            a._replace(per_run=o) for a, o in zip(traced.arguments, flags, strict=True)
        ]
        program = build(traced.jaxpr, [*arguments, None], batched, limits)
        if wanted is not None:
            kept = [i for i, place in enumerate(program.places) if place in wanted]
            program = program._replace(
                outputs=[program.outputs[i] for i in kept],
                places=[program.places[i] for i in kept],
            )
        self.kernel = Kernel(program, batched, limits)
        self.arguments, self.own = arguments, flags
        self.memory = threading.local()
        self.results = jax.tree.structure(traced.results)

    def arrays(self, leaves: Sequence[Any]) -> list[np.ndarray | None]:
        """The arguments as the machine code reads them."""
        pairs = zip(leaves, self.arguments, strict=True)
        return [*(prepared(leaf, argument.kind) for leaf, argument in pairs), None]

    def raw(self, leaves: Sequence[Any], events: int, runs: int) -> list[np.ndarray]:
        """The results as the machine code leaves them: by group of runs, event, place, run.

        Their memory is the thread's, and used again by its next call: new memory costs as much
        as computing what is put there.
        """
        kept = getattr(self.memory, "kept", None)
        if kept is None or kept[0] != (events, runs):
            kept = (events, runs), self.kernel.fresh(events, runs)
            self.memory.kept = kept
        self.kernel.run(self.arrays(leaves), kept[1], events, runs)
        return kept[1]

    def tree(self, leaves: Sequence[Any], values: Sequence[Any]) -> Any:
        """Results in the form that the traced program has; None where they are not wanted."""
        flat: list[Any] = [None] * self.results.num_leaves
        for place, number in self.kernel.passed.items():
            flat[place] = leaves[number]
        for place, value in zip(self.kernel.places, values, strict=True):
            flat[place] = value
        return jax.tree.unflatten(self.results, flat)


class One:
    """A pass over one log."""

    def __init__(self, compiled: NativePass, keep: Keep, history: bool):
        self.compiled, self.keep, self.history = compiled, keep, history

    def over(self, filter: AbstractFilter, rig: Rig, log: Log) -> Any:
        """Estimates, with the history if it was asked for, or what ``keep`` picks."""
        return self.bound(filter, rig, log)()

    def bound(self, filter: AbstractFilter, rig: Rig, log: Log) -> Callable[[], Any]:
        """The pass over that log as a call."""
        leaves = jax.tree.leaves((filter, rig, log))
        arrays = self.compiled.arrays(leaves)
        kernel, events = self.compiled.kernel, log.schedule.time.shape[0]

        def call() -> Any:
            outputs = kernel.fresh(events, 1)
            kernel.run(arrays, outputs, events)
            returned = jax.device_put([o.reshape(o.shape[1:-1]) for o in outputs])
            estimates, history, _ = self.compiled.tree(leaves, returned)
            if self.keep is not None:
                return _picked(self.keep, estimates)
            return (estimates, history) if self.history else estimates

        return call


class Many:
    """A pass over the logs of several runs."""

    def __init__(self, compiled: NativePass, keep: Keep):
        self.compiled, self.keep = compiled, keep

    def most_runs(self, log: Log) -> int:
        """How many runs one call takes at most, in whole registers."""
        kernel = self.compiled.kernel
        fit = MOST_BYTES // max(kernel.size(log.schedule.time.shape[0]), 1)
        return max(fit // kernel.lanes, cores()) * kernel.lanes

    def over(self, filter: AbstractFilter, rig: Rig, log: Log, runs: int) -> Any:
        """What ``keep`` picks of each run, with a leading axis of runs."""
        leaves = jax.tree.leaves((filter, rig, log))
        events = log.schedule.time.shape[0]
        raw = self.compiled.raw(leaves, events, runs)
        passed = [leaves[number] for number in self.compiled.kernel.passed.values()]
        # Waited for, since the memory is used again.
        return jax.block_until_ready(_unpacked(self.compiled, self.keep, runs, raw, passed))

    def raw(self, filter: AbstractFilter, rig: Rig, log: Log, runs: int) -> Estimates:
        """Estimates as the machine code leaves them, None where ``keep`` does not look.

        See :func:`by_run`. They are overwritten by the thread's next call.
        """
        leaves = jax.tree.leaves((filter, rig, log))
        raw = self.compiled.raw(leaves, log.schedule.time.shape[0], runs)
        return self.compiled.tree(leaves, raw)[0]


def by_run(array: Any, runs: int) -> Any:
    """Numbers by group of runs, event, place and run within the group, in the order of runs."""
    runs_last = jnp.moveaxis(array, -1, 1)
    return runs_last.reshape(-1, *runs_last.shape[2:])[:runs]


@eqx.filter_jit
def _picked(keep: Callable[[Estimates], Any], estimates: Estimates) -> Any:
    return keep(estimates)


@eqx.filter_jit
def _unpacked(
    compiled: NativePass, keep: Keep, runs: int, raw: list[Any], passed: list[Any]
) -> Any:
    """Results run by run, and of each what is kept; one compiled program."""
    kernel = compiled.kernel

    def one(values: list[Any]) -> Any:
        flat: list[Any] = [None] * compiled.results.num_leaves
        for place, value in zip(kernel.passed, passed, strict=True):
            flat[place] = value
        for place, value in zip(kernel.places, values, strict=True):
            flat[place] = value
        estimates = jax.tree.unflatten(compiled.results, flat)[0]
        return estimates if keep is None else keep(estimates)

    return jax.vmap(one)([by_run(array, runs) for array in raw])


def native_pass(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    history: bool,
    keep: Keep,
    per_run: Any,
    work: int = 0,
) -> One | Many:
    """The compiled pass for this structure and these shapes; compiled once in a process.

    Raises:
        Unsupported: the program is not straight-line code, or too large.
    """
    if log.schedule.time.shape[0] == 0:
        raise Unsupported("a log without events")
    leaves, structure = jax.tree.flatten((filter, rig, log))
    flags = None if per_run is None else tuple(jax.tree.leaves(per_run))
    model, rows = (
        jax.tree.map(lambda _: False, (filter, rig)),
        jax.tree.map(lambda _: True, log),
    )
    of_log = tuple(jax.tree.leaves((model, rows)))
    shapes = []
    for leaf, is_log, has_runs in zip(
        leaves, of_log, flags or [False] * len(leaves), strict=True
    ):
        shape = leaf.shape[1:] if has_runs else leaf.shape
        if is_log:
            shape = (min(shape[0], ROWS), *shape[1:])
        shapes.append((shape, str(leaf.dtype)))
    form = structure, tuple(shapes), of_log, history
    try:
        wanted = None if keep is None else _wanted(form, keep)
    except TypeError:  # it holds arrays, so that it cannot be looked up
        wanted = _wanted.__wrapped__(form, keep)
    compiled = _compiled(form, flags, wanted, LONG if work >= MUCH else SHORT)
    return One(compiled, keep, history) if flags is None else Many(compiled, keep)


@ft.lru_cache(maxsize=64)
def _traced(form: Form) -> Traced:
    structure, shapes, of_log, history = form
    arrays = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in shapes]

    def program(leaves: list[Any], key: Any) -> Any:
        filter, rig, log = jax.tree.unflatten(structure, leaves)
        return whole_pass(filter, rig, log, key, history)

    make: Any = jax.make_jaxpr(program, return_shape=True)
    jaxpr, results = make(arrays, jr.key(0))
    arguments = [
        Argument(kind_of(dtype), shape, False, is_log and shape[0] > 0)
        for (shape, dtype), is_log in zip(shapes, of_log, strict=True)
    ]
    return Traced(jaxpr, arguments, results)


@ft.lru_cache(maxsize=64)
def _compiled(
    form: Form,
    flags: tuple[bool, ...] | None,
    wanted: frozenset[int] | None,
    limits: Limits,
) -> NativePass:
    return NativePass(_traced(form), flags, wanted, limits)


@ft.lru_cache(maxsize=64)
def _wanted(form: Form, keep: Callable[[Estimates], Any]) -> frozenset[int]:
    """Numbers of the results that ``keep`` looks at."""
    jaxpr = jax.make_jaxpr(lambda both: keep(both[0]))(_traced(form).results).jaxpr
    live = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}
    for equation in reversed(jaxpr.eqns):
        if live.intersection(equation.outvars):
            live.update(a for a in equation.invars if not isinstance(a, Literal))
    return frozenset(i for i, variable in enumerate(jaxpr.invars) if variable in live)
