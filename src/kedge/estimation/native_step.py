"""Waiting events by the machine code of a pass, over rows of memory that stay in place."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from kedge.compiler.algebra import TYPES
from kedge.compiler.emit import HEAD
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError
from kedge.estimation.compiled import Engine, compiled_pass
from kedge.estimation.live_steps import BATCH, Steps, Trail
from kedge.estimation.rig import Rig
from kedge.estimation.rows import EventForm
from kedge.estimation.step import FilterState

NO_EVENT = -1
STRETCH = 16
"""Events after which the words are kept: what is late is done again from there."""
ENDLESS = 2**62
"""Events to come: so many that a long program is worth its compilation."""


class NotCompiled(ContractError):
    """Machine code cannot do what is asked for."""


class NativeSteps(Steps):
    """The event step by machine code.

    Readings that bring a covariance have a program of their own, compiled when the first comes,
    and so has the smoother. All of them carry the same words from event to event.

    Raises:
        NotCompiled: machine code cannot do it.
        ContractError: it is asked for by name, and cannot.
    """

    def __init__(
        self,
        filter: AbstractFilter,
        rig: Rig,
        events: EventForm,
        state: FilterState,
        engine: Engine,
    ):
        super().__init__(filter, rig, events, state)
        self._given = filter, rig, engine
        self._has_cov, self._sensor = self.rows["has_cov"], self.rows["sensor"]
        self._programs: dict[tuple[int, bool], Program] = {}
        self._carry = np.zeros(0, np.int64)
        self._known: Any = None  # whose numbers stand in the carry
        plain = self._program(NO_EVENT)
        self._plain = [plain.stretch(begin) for begin in range(0, BATCH, STRETCH)]

    def run(self, count: int, words: np.ndarray) -> Trail:
        """The first ``count`` rows done; the words after some of them, and after the last."""
        if words is not self._known:
            self._carry[:] = words
        trail: Trail = [None] * count
        if self._has_cov[0] if count == 1 else self._has_cov[:count].any():
            self._mixed(count, False)
        else:
            for begin, (block, call) in zip(
                range(0, count, STRETCH), self._plain, strict=False
            ):
                end = block[0] = min(STRETCH, count - begin)
                call()
                trail[begin + end - 1] = self._carry.copy()
            self._known = trail[-1]
            return trail
        self._known = trail[-1] = self._carry.copy()
        return trail

    def record(self, count: int, words: np.ndarray) -> np.ndarray:
        """The same with what a smoother needs of each, in ``recorded``; the last words."""
        self._carry[:] = words
        self._mixed(count, True)
        self._known = after = self._carry.copy()
        return after

    def prepare(self) -> None:
        """Compile all that can come."""
        for with_cov in range(NO_EVENT, len(self._events.measures)):
            for history in (False, True)[: 1 + self.smoothable]:
                self._program(with_cov, history)

    def pack(self, state: FilterState) -> np.ndarray:
        """The words of a state."""
        words, leaves = np.empty(len(self._carry), np.int64), jax.tree.leaves(state)
        for place, part, _ in self._words:
            array = np.asarray(leaves[place]).ravel()
            wide = array.astype(np.float64 if array.dtype.kind == "f" else np.int64)
            words[part] = wide.view(np.int64)
        return words

    def unpack(self, words: np.ndarray) -> FilterState:
        """The state of words; what no event changes is as it was at first."""
        structure = jax.tree.structure(self._state)
        leaves, numbers = jax.tree.leaves(self._state), words.view(np.float64)
        for place, part, kind in self._words:
            array = numbers[part] if kind == "f8" else words[part].astype(TYPES[kind])
            leaves[place] = np.array(array.reshape(leaves[place].shape))
        return structure.unflatten(leaves)

    def _mixed(self, count: int, history: bool) -> None:
        """Parts of the rows, each by the program that knows whose covariance comes with it."""
        begin, program = 0, NO_EVENT
        spreads, sensors = self._has_cov[:count].tolist(), self._sensor[:count].tolist()
        for place, (spread, rank) in enumerate(zip(spreads, sensors, strict=True)):
            wanted = rank if spread else NO_EVENT
            if wanted != program and place > begin:
                self._program(program, history).part(begin, place)
                begin = place
            program = wanted
        self._program(program, history).part(begin, count)

    def _program(self, with_cov: int, history: bool = False) -> "Program":
        known = self._programs.get((with_cov, history))
        return self._compiled(with_cov, history) if known is None else known

    def _compiled(self, with_cov: int, history: bool) -> "Program":
        (filter, rig, engine), events = self._given, self._events
        form, answers = self.form, self.answers
        if history:
            form, answers = self.recorded_form, self.recorded
        log = events.views(self.rows, with_cov)
        traced = jax.tree.map(
            lambda leaf: jax.numpy.zeros((1, *leaf.shape[1:]), leaf.dtype), log
        )
        pitches = events.pitch, form.dtype.itemsize
        compiled = compiled_pass(
            filter, rig, traced, history, engine, work=ENDLESS, pitches=pitches
        )
        if compiled is None:
            raise NotCompiled("no machine code for what came: engine='xla' runs it")
        kernel = compiled.kernel
        *_, last = jax.tree.unflatten(compiled.results, range(compiled.results.num_leaves))
        words = [
            (place, kernel.ends[number], kernel.carried[kernel.ends[number].start])
            for place, number in enumerate(jax.tree.leaves(last))
            if number in kernel.ends
        ]
        if not self._programs:
            self._carry, self._words = kernel.carry(1)[0], words
        if words != self._words:
            raise AssertionError("programs of one rig that carry other words")
        program = Program(compiled, (filter, rig), log, form.fields(answers), self._carry)
        self._programs[with_cov, history] = program
        return program


class Program:
    """One compiled step over the rows; ``fields`` is where its results go."""

    def __init__(self, compiled: Any, given: Any, log: Any, fields: Any, carry: np.ndarray):
        kernel = compiled.kernel
        rows = jax.tree.leaves(log)
        *fixed, _ = compiled.arrays([*jax.tree.leaves(given), *map(np.array, rows)])
        self._kept = [*fixed[: -len(rows)], *rows], fields, carry
        # By the number of the result: the time, which stays as it came, then the fields.
        outputs = [fields[place - 1] for place in kernel.places]
        self.block = kernel.block([*self._kept[0], None], outputs, carry, 0, 0, 1, anew=False)
        self._call = kernel.code.call
        self._whole, self._step = self.block.copy(), np.zeros_like(self.block)
        first = len(fixed) - len(rows)
        for number, array in enumerate(rows, start=first):
            self._step[HEAD + 3 * number] = array.strides[0]
        self._step[-len(outputs) :] = outputs[0].strides[0]
        self._step[HEAD + 3 * (first + 2)] = 0  # its numbers count from where a part begins

    def part(self, begin: int, end: int) -> None:
        """Do the rows from ``begin`` to ``end``."""
        self.block[:] = self._whole + begin * self._step
        self.block[0] = end - begin
        self._call(self.block.ctypes.data)

    def stretch(self, begin: int) -> tuple[np.ndarray, Callable[[], None]]:
        """Rows from ``begin`` on: a block whose first word says how many, and the call."""
        block, call = self._whole + begin * self._step, self._call
        address = block.ctypes.data
        return block, lambda: call(address)
