"""Events one by one by the programs of XLA, in the same rows as machine code has them."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractFilter
from kedge.estimation.admission import FLOAT
from kedge.estimation.compiled import Engine
from kedge.estimation.live_steps import Steps, Trail, moments_of
from kedge.estimation.native_step import NativeSteps, NotCompiled
from kedge.estimation.rig import Rig
from kedge.estimation.rows import NO_SENSOR, EventForm
from kedge.estimation.step import FilterState, predict_to, process_measurement


class TracedSteps(Steps):
    """The event step by XLA."""

    def __init__(
        self,
        filter: AbstractFilter,
        rig: Rig,
        events: EventForm,
        state: FilterState,
        key: PRNGKeyArray,
    ):
        super().__init__(filter, rig, events, state)
        self._filter, self._rig, self._key = filter, rig, key
        self._structure = jax.tree.structure(state)
        self._shapes = [(np.shape(leaf), leaf.dtype) for leaf in jax.tree.leaves(state)]
        self._known: tuple[Any, Any] = None, None

    def run(self, count: int, words: np.ndarray) -> Trail:
        """The first ``count`` rows done, and the words after each of them."""
        return self._run(count, words, self.answers, False)

    def record(self, count: int, words: np.ndarray) -> np.ndarray:
        """The same with what a smoother needs of each, in ``recorded``; the last words."""
        return self._run(count, words, self.recorded, True)[-1]

    def prepare(self) -> None:
        """Compile all that can come, by an event of each kind whose answer nobody sees."""
        words, kept = self.pack(self._state), self.rows[:1].copy()
        self.rows[:1] = self._events.blank(1)
        for rank in range(NO_SENSOR, len(self._events.measures)):
            for with_cov in (False, True)[: 1 if rank == NO_SENSOR else 2]:
                self.rows["sensor"][0], self.rows["has_cov"][0] = rank, with_cov
                self.run(1, words)
                if self.smoothable:
                    self.record(1, words)
        self.rows[:1], self._known = kept, (None, None)

    def pack(self, state: FilterState) -> np.ndarray:
        """The words of a state: its bytes."""
        return np.frombuffer(
            b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(state)), np.uint8
        )

    def unpack(self, words: np.ndarray) -> FilterState:
        """The state of words."""
        leaves, begin, whole = [], 0, words.tobytes()
        for shape, dtype in self._shapes:
            count = int(np.prod(shape, dtype=int))
            part = np.frombuffer(whole, dtype, count, begin).reshape(shape)
            leaves.append(jax.numpy.asarray(part))
            begin += count * dtype.itemsize
        return self._structure.unflatten(leaves)

    def _run(self, count: int, words: Any, answers: Any, record: bool) -> Trail:
        state = self._known[1] if words is self._known[0] else self.unpack(words)
        form, trail = self.recorded_form if record else self.form, []
        for place in range(count):
            row = self.rows[place]
            control = self._events.control(row["held"], FLOAT)
            time: Any = np.asarray(row["seconds"], FLOAT)
            # With all its digits, whatever the type of the arrays.
            dt: Any = np.asarray(row["seconds"] - row["since"], FLOAT)
            state, past = _predict_to(
                self._filter, self._rig.vehicle, state, control, time, self._key, record, dt
            )
            answers[place] = form.silence[0]
            if row["sensor"] != NO_SENSOR:
                state, outcome = _process_measurement(
                    self._filter, self._rig.sensors, int(row["sensor"]), state,
                    self._events.reading(row, FLOAT), self._key,
                )  # fmt: skip
                for name, value in outcome._asdict().items():
                    answers[name][place] = value
            for name, tree in (("moments", moments_of(state.belief)), ("record", past)):
                for i, leaf in enumerate(jax.tree.leaves(tree)):
                    answers[name][f"f{i}"][place] = leaf
            trail.append(self.pack(state))
        self._known = trail[-1], state
        return trail


def steps_for(
    filter: AbstractFilter, rig: Rig, form: EventForm, state: Any, key: Any, engine: Engine
) -> Steps:
    """The engine asked for, or the one that can."""
    try:
        return NativeSteps(filter, rig, form, state, engine)
    except NotCompiled:
        return TracedSteps(filter, rig, form, state, key)


# Compiled, because an operation that is not costs as much as an event.
_predict_to = eqx.filter_jit(predict_to)
_process_measurement = eqx.filter_jit(process_measurement)
