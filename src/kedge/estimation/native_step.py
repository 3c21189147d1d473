"""One event at a time by the machine code of a pass, over memory that stays where it is."""

import math
from typing import Any

import jax
import numpy as np

from kedge.compiler.algebra import TYPES
from kedge.compiler.kernel import prepared
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import space_of
from kedge.estimation.compiled import Engine, compiled_pass
from kedge.estimation.delayed import Event, State
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Rig
from kedge.estimation.step import Outcome, Standing

NO_EVENT = -1


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
        own = event.rank if reading is not None and reading.cov is not None else NO_EVENT
        if own not in self._programs:
            self._programs[own] = self._compiled(own)
        program = self._programs[own]
        return None if program is None else program.take(state, event)

    def _compiled(self, own: int) -> "Program | None":
        readings = tuple(
            _blank(installation.sensor.measures, number == own)
            for number, installation in enumerate(self._rig.sensors)
        )
        time: Any = np.zeros(1)
        sensor: Any = np.zeros(1, np.int64)
        row: Any = np.zeros(1, np.int64)
        controls = jax.tree.map(lambda leaf: np.zeros((1, *np.shape(leaf))), self._control)
        log = Log(Schedule(time, sensor, row), controls, readings)
        found = compiled_pass(
            self._filter, self._rig, jax.tree.map(jax.numpy.asarray, log), self._history,
            self._engine,
        )  # fmt: skip
        return None if found is None else Program(found.compiled, self._filter, self._rig, log)


class Program:
    """The compiled step with its memory."""

    def __init__(self, compiled: Any, filter: AbstractFilter, rig: Rig, log: Log):
        self._log = log
        kernel = compiled.kernel
        self._call = kernel.code.call
        fixed = jax.tree.leaves((filter, rig))
        kinds = [argument.kind for argument in compiled.arguments]
        self._arrays = [
            prepared(leaf, kind) for leaf, kind in zip(fixed, kinds, strict=False)
        ] + jax.tree.leaves(log)
        self._carry = kernel.carry(1)
        self._outputs = kernel.fresh(1, 1)
        self._block = kernel.block(
            [*self._arrays, None], self._outputs, self._carry, 1, 0, 1, anew=False
        )
        self._address = self._block.ctypes.data
        self._controls = jax.tree.leaves(log.controls)
        self._held: Any = None
        self._readings = [jax.tree.leaves(readings) for readings in log.readings]
        # Where each result lies: a view of the memory, or an argument as it came.
        flat: list[Any] = [None] * compiled.results.num_leaves
        for place, number in kernel.passed.items():
            flat[place] = self._arrays[number]
        for place, output in zip(kernel.places, self._outputs, strict=True):
            flat[place] = output.reshape(output.shape[2:-1])
        estimates, self._history, left = compiled.results.children()
        _, moments, _ = estimates.children()
        begin = 1 + moments.num_leaves
        self._mean, _ = moments.children()
        self._moments = flat[1:begin]
        self._outcome = flat[begin : estimates.num_leaves]
        self._past = flat[estimates.num_leaves : -left.num_leaves]
        # What no event changes is not carried: it stays as it was in the standing.
        first = compiled.results.num_leaves - left.num_leaves
        self._kinds = kernel.carried
        self._carried = [place - first for place in sorted(kernel.ends, key=kernel.ends.get)]
        self._parts: list[tuple[int, slice, tuple[int, ...], str]] | None = None
        self._shape: Any = None

    def take(self, state: State, event: Event) -> tuple[State, Any, Any, Any]:
        """The event done in the memory, and copies of what it left there."""
        schedule, reading = self._log.schedule, event.reading
        schedule.time[0] = event.time
        schedule.sensor[0] = NO_EVENT if reading is None else event.rank
        if state.control is not self._held:  # else it stands there
            for there, value in zip(
                self._controls, jax.tree.leaves(state.control), strict=True
            ):
                there[0] = value
            self._held = state.control
        if reading is not None:
            place = self._readings[event.rank]
            for there, value in zip(place, jax.tree.leaves(reading), strict=True):
                there[0] = value
        carry = self._carry[0]
        carry[:] = self._packed(state) if state.words is None else state.words
        self._call(self._address)
        words = carry.copy()
        standing = self._standing(state.standing, words)
        moves = state.moves + (event.time > state.time)
        takes = state.takes + (reading is not None)
        control = state.control if event.control is None else event.control
        after = State(standing, event.time, control, moves, takes, words)
        *mean, cov = [view.copy() for view in self._moments]
        moments = Gaussian(self._mean.unflatten(mean), cov)
        outcome = Outcome(*[view.copy() for view in self._outcome])
        past = self._history.unflatten([view.copy() for view in self._past])
        return after, moments, outcome, past

    def _packed(self, state: State) -> np.ndarray:
        numbers = [*jax.tree.leaves(state.standing), state.time, state.moves, state.takes]
        parts = []
        for number in (numbers[place] for place in self._carried):
            array = np.asarray(number).ravel()
            is_float = array.dtype.kind == "f"
            wide = array.astype(np.float64 if is_float else np.int64)
            parts.append(wide.view(np.int64))
        return np.concatenate(parts)

    def _standing(self, like: Standing, words: np.ndarray) -> Standing:
        if self._parts is None:
            leaves, self._shape = jax.tree.flatten(like)
            self._parts, begin = [], 0
            for place in self._carried:
                if place >= len(leaves):  # not of the standing
                    break
                shape = np.shape(leaves[place])
                end = begin + math.prod(shape)
                self._parts.append((place, slice(begin, end), shape, self._kinds[begin]))
                begin = end
        leaves, numbers = self._shape.flatten_up_to(like), words.view(np.float64)
        for place, cut, shape, kind in self._parts:
            found = numbers[cut] if kind == "f8" else words[cut].astype(TYPES[kind])
            leaves[place] = found.reshape(shape)
        return self._shape.unflatten(leaves)


def _blank(measures: Any, with_cov: bool) -> Readings:
    outputs = space_of(measures)
    zeros = [np.zeros((1, *chart.shape)) for chart in outputs.charts]
    cov: Any = np.zeros((1, outputs.size, outputs.size)) if with_cov else None
    target: Any = np.zeros(1, np.int64)
    return Readings(measures(*zeros), target, cov)
