"""What both engines share that do waiting events: rows that they read, rows that they write."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.rows import AnswerForm, EventForm, words_of
from kedge.estimation.step import FilterState, begin, silence, widest
from kedge.estimation.transition import is_smoothable, still

BATCH = 64
"""Events that one call takes at most: what comes late is done again from the end of a call."""


Trail = list[Any]
"""Words after each event, None where they are not kept; those after the last are."""


class Steps(abc.ABC):
    """The event step for one rig over ``rows``; what an event leaves stands in ``answers``.

    ``recorded`` is where a smoother finds what it needs as well. What is carried from event to
    event are words: an array that nobody changes.
    """

    def __init__(self, filter: AbstractFilter, rig: Rig, events: EventForm, state: FilterState):
        self.smoothable = is_smoothable(filter)
        quiet = jax.tree.map(np.asarray, silence(widest(rig.sensors)))
        moments = jax.eval_shape(_moments, state.belief)
        past: Any = None
        if self.smoothable:
            past = jax.eval_shape(lambda belief: _still(filter, belief), state.belief)
        self.form = AnswerForm(quiet, moments)
        self.recorded_form = AnswerForm(quiet, moments, past)
        self.rows = events.blank(BATCH)
        self.rows["row"] = np.arange(BATCH)
        self.answers = np.zeros(BATCH, self.form.dtype)
        self.recorded = np.zeros(BATCH, self.recorded_form.dtype)
        self.row_words, self.answer_words = words_of(self.rows), words_of(self.answers)
        self._events, self._state = events, state

    @abc.abstractmethod
    def run(self, count: int, words: np.ndarray) -> Trail:
        """The first ``count`` rows done from ``words`` on; the words after each of them."""

    @abc.abstractmethod
    def record(self, count: int, words: np.ndarray) -> np.ndarray:
        """The same into ``recorded``; the last words."""

    @abc.abstractmethod
    def prepare(self) -> None:
        """Compile all that can come."""

    @abc.abstractmethod
    def pack(self, state: FilterState) -> np.ndarray:
        """The words of a state."""

    @abc.abstractmethod
    def unpack(self, words: np.ndarray) -> FilterState:
        """The state of words."""

    def first_answer(self, state: FilterState) -> np.ndarray:
        """A row that says nothing but what is believed."""
        row = self.form.silence.copy()
        for i, leaf in enumerate(jax.tree.leaves(moments_of(state.belief))):
            row["moments"][f"f{i}"][0] = leaf
        return row

    def to_smooth(self, count: int) -> list[tuple[Gaussian, Any]]:
        """Moments and record of the first rows of ``recorded``."""
        rows, form = self.recorded[:count].copy(), self.recorded_form
        return [(form.tree(row), form.tree(row, "record")) for row in rows]


def begin_live(
    filter: AbstractFilter, rig: Rig, key: PRNGKeyArray, seconds: float = 0.0
) -> FilterState:
    """The prior as what is carried into the first event after some seconds."""
    return _begin(filter, rig, key, jnp.asarray(seconds, float))


def moments_of(belief: Any) -> Gaussian:
    """Mean and covariance, without a program where they are at hand."""
    return belief if isinstance(belief, Gaussian) else _moments(belief)


# Compiled, because an operation that is not costs as much as an event; and traced once for all
# estimators of one structure.
_begin = eqx.filter_jit(
    lambda filter, rig, key, seconds: as_arrays(begin(filter, rig, key, seconds))
)
_moments = eqx.filter_jit(lambda belief: belief.moments())
_still = eqx.filter_jit(still)
