"""One event at a time by the machine code of a pass, over memory that stays where it is."""

from typing import Any

import jax
import numpy as np

from kedge.compiler.algebra import TYPES
from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import space_of
from kedge.estimation.compiled import Engine, compiled_pass
from kedge.estimation.delayed import Event, State
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Rig
from kedge.estimation.step import FilterState

NO_EVENT = -1
ENDLESS = 2**62
"""Events to come: so many that a long program is worth its compilation."""


class NativeStep:
    """The event step for one rig; ``take`` gives None where machine code cannot do it.

    Readings that bring a covariance have a program of their own, compiled when the first comes.
    """

    def __init__(
        self, filter: AbstractFilter, rig: Rig, control: Any, history: bool, engine: Engine
    ):
        self._filter, self._rig, self._history = filter, rig, history
        self._engine: Engine = engine
        self._control = control
        self._programs: dict[int, Program | None] = {}

    def take(self, state: State, event: Event) -> tuple[State, Any, Any, Any] | None:
        """The state after an event, the moments, the outcome and the smoother's share."""
        reading = event.reading
        with_cov = event.rank if reading is not None and reading.cov is not None else NO_EVENT
        if with_cov not in self._programs:
            self._programs[with_cov] = self._compiled(with_cov)
        program = self._programs[with_cov]
        return None if program is None else program.take(state, event)

    def _compiled(self, with_cov: int) -> "Program | None":
        readings = tuple(
            _blank(installation.sensor.measures, number == with_cov)
            for number, installation in enumerate(self._rig.sensors)
        )
        time: Any = np.zeros(1)
        sensor: Any = np.zeros(1, np.int64)
        row: Any = np.zeros(1, np.int64)
        controls = jax.tree.map(lambda leaf: np.zeros((1, *np.shape(leaf))), self._control)
        log = Log(Schedule(time, sensor, row), controls, readings)
        compiled = compiled_pass(
            self._filter, self._rig, jax.tree.map(jax.numpy.asarray, log), self._history,
            self._engine, work=ENDLESS,
        )  # fmt: skip
        return None if compiled is None else Program(compiled, self._filter, self._rig, log)


class Program:
    """The compiled step with its memory."""

    def __init__(self, compiled: Any, filter: AbstractFilter, rig: Rig, log: Log):
        kernel = compiled.kernel
        self._call = kernel.code.call
        leaves, structure = jax.tree.flatten((filter, rig, log))
        *self._arrays, key = compiled.arrays(leaves)
        self._carry = kernel.carry(1)
        self._outputs = kernel.fresh(1, 1)
        self._block = kernel.block(
            [*self._arrays, key], self._outputs, self._carry, 1, 0, 1, anew=False
        )
        self._address = self._block.ctypes.data
        # The memory that the code reads, by the log's names.
        *_, self._log = jax.tree.unflatten(structure, self._arrays)
        self._controls = jax.tree.leaves(self._log.controls)
        self._held: Any = None
        self._readings = [jax.tree.leaves(readings) for readings in self._log.readings]
        # What it leaves there: views of the memory it writes, or arguments as they came.
        views = [output.reshape(output.shape[2:-1]) for output in self._outputs]
        estimates, history, _ = compiled.tree(self._arrays, views)
        results = estimates.moments, estimates.outcome, history
        self._results, self._form = jax.tree.flatten(results)
        # And the words of the state that it carries; none for what no event changes: that
        # stays as it was.
        *_, last = jax.tree.unflatten(compiled.results, range(compiled.results.num_leaves))
        numbers, self._shape = jax.tree.flatten(last)
        self._kinds = kernel.carried
        self._words = [
            (place, kernel.ends[number], self._kinds[kernel.ends[number].start])
            for place, number in enumerate(numbers)
            if number in kernel.ends
        ]

    def take(self, state: State, event: Event) -> tuple[State, Any, Any, Any]:
        """The event done in the memory, and copies of what it left there."""
        schedule, reading = self._log.schedule, event.reading
        schedule.time[0] = event.time
        schedule.sensor[0] = NO_EVENT if reading is None else event.rank
        if state.control is not self._held:  # else it stands there
            for slot, value in zip(self._controls, jax.tree.leaves(state.control), strict=True):
                slot[0] = value
            self._held = state.control
        if reading is not None:
            place = self._readings[event.rank]
            for slot, value in zip(place, jax.tree.leaves(reading), strict=True):
                slot[0] = value
        carry = self._carry[0]
        carry[:] = self._packed(state) if state.words is None else state.words
        self._call(self._address)
        words = carry.copy()
        control = state.control if event.control is None else event.control
        after = State(self._unpacked(state.filter, words), event.time, control, words)
        return after, *self._form.unflatten([view.copy() for view in self._results])

    def _packed(self, state: State) -> np.ndarray:
        words, leaves = np.empty(len(self._kinds), np.int64), jax.tree.leaves(state.filter)
        for place, part, _ in self._words:
            array = np.asarray(leaves[place]).ravel()
            wide = array.astype(np.float64 if array.dtype.kind == "f" else np.int64)
            words[part] = wide.view(np.int64)
        return words

    def _unpacked(self, like: FilterState, words: np.ndarray) -> FilterState:
        leaves, numbers = self._shape.flatten_up_to(like), words.view(np.float64)
        for place, part, kind in self._words:
            array = numbers[part] if kind == "f8" else words[part].astype(TYPES[kind])
            leaves[place] = array.reshape(leaves[place].shape)
        return self._shape.unflatten(leaves)


def _blank(measures: Any, with_cov: bool) -> Readings:
    outputs = space_of(measures)
    zeros = [np.zeros((1, *chart.shape)) for chart in outputs.charts]
    cov: Any = np.zeros((1, outputs.size, outputs.size)) if with_cov else None
    target: Any = np.zeros(1, np.int64)
    return Readings(measures(*zeros), target, cov)
