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
Pitches = tuple[int, int]
"""Of rows that one run's events are read from, in numbers, and its results written to, in
bytes: such a program takes and leaves rows of structured arrays."""
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
        pitches: Pitches | None = None,
    ):
        batched = per_run is not None
        flags = per_run or [False] * len(traced.arguments)
        arguments = [
            a._replace(per_run=o) for a, o in zip(traced.arguments, flags, strict=True)
        ]
        row, pitch = pitches or (None, None)
        arguments = [a._replace(pitch=row) if a.open_ended else a for a in arguments]
        program = build(traced.jaxpr, [*arguments, None], batched, limits)
        if wanted is not None:
            kept = [i for i, place in enumerate(program.places) if place in wanted]
            program = program._replace(
                outputs=[program.outputs[i] for i in kept],
                places=[program.places[i] for i in kept],
            )
        self.kernel = Kernel(program, batched, limits, pitch)
        self.arguments = arguments
        self.memory = threading.local()
        self.results = jax.tree.structure(traced.results)

    def arrays(self, leaves: Sequence[Any]) -> list[np.ndarray | None]:
        """The arguments as the machine code reads them."""
        pairs = zip(leaves, self.arguments, strict=True)
        return [*(prepared(leaf, argument.kind) for leaf, argument in pairs), None]

    def tree(self, leaves: Sequence[Any], values: Sequence[Any]) -> Any:
        """Results in the form that the traced program has; None where they are not wanted."""
        flat: list[Any] = [None] * self.results.num_leaves
        for place, number in self.kernel.passed.items():
            flat[place] = leaves[number]
        for place, value in zip(self.kernel.places, values, strict=True):
            flat[place] = value
        return jax.tree.unflatten(self.results, flat)

    def bound(self, given: Any) -> Callable[[], Any]:
        """The pass over one log as a call, which gives what the traced program gives."""
        leaves, events = jax.tree.leaves(given), _events(given)
        arrays = self.arrays(leaves)

        def call() -> Any:
            outputs = self.kernel.fresh(events, 1)
            self.kernel.run(arrays, outputs, events)
            return self.tree(
                leaves, jax.device_put([o.reshape(o.shape[1:-1]) for o in outputs])
            )

        return call

    def most_runs(self, given: Any) -> int:
        """How many runs one call takes at most, in whole registers."""
        fit = MOST_BYTES // max(self.kernel.size(_events(given)), 1)
        return max(fit // self.kernel.lanes, cores()) * self.kernel.lanes

    def over_runs(self, given: Any, runs: int, keep: Keep) -> Any:
        """What ``keep`` picks of the estimates of each run, with a leading axis of runs.

        The memory in which the machine code leaves them is the thread's, and used again by its
        next call: new memory costs as much as computing what is put there.
        """
        leaves, events = jax.tree.leaves(given), _events(given)
        kept = getattr(self.memory, "kept", None)
        if kept is None or kept[0] != (events, runs):
            kept = self.memory.kept = (events, runs), self.kernel.fresh(events, runs)
        self.kernel.run(self.arrays(leaves), kept[1], events, runs)
        raw, _, _ = self.tree([None] * len(leaves), kept[1])
        passed, _, _ = self.tree(leaves, [None] * len(kept[1]))
        return jax.block_until_ready(_by_run(keep, runs, raw, passed))


def _events(given: Any) -> int:
    return given[2].schedule.time.shape[0]


@eqx.filter_jit
def _by_run(keep: Keep, runs: int, raw: Estimates, passed: Estimates) -> Any:
    """What is kept of each run; one program for all filters whose estimates look alike.

    ``raw`` has numbers by group of runs, event, place and run within the group.
    """

    def ordered(array: Any) -> Any:
        runs_last = jnp.moveaxis(array, -1, 1)
        return runs_last.reshape(-1, *runs_last.shape[2:])[:runs]

    def one(estimates: Estimates) -> Any:
        whole = eqx.combine(estimates, passed)
        return whole if keep is None else keep(whole)

    return jax.vmap(one)(jax.tree.map(ordered, raw))


def native_pass(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    history: bool,
    keep: Keep,
    per_run: Any,
    work: int = 0,
    pitches: Pitches | None = None,
) -> NativePass:
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
    return _compiled(form, flags, wanted, LONG if work >= MUCH else SHORT, pitches)


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
    pitches: Pitches | None = None,
) -> NativePass:
    return NativePass(_traced(form), flags, wanted, limits, pitches)


@ft.lru_cache(maxsize=64)
def _wanted(form: Form, keep: Callable[[Estimates], Any]) -> frozenset[int]:
    """Numbers of the results that ``keep`` looks at."""
    jaxpr = jax.make_jaxpr(lambda both: keep(both[0]))(_traced(form).results).jaxpr
    live = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}
    for equation in reversed(jaxpr.eqns):
        if live.intersection(equation.outvars):
            live.update(a for a in equation.invars if not isinstance(a, Literal))
    return frozenset(i for i, variable in enumerate(jaxpr.invars) if variable in live)
