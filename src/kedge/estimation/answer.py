"""What an online estimator answers to an event."""

from typing import Any, NamedTuple

import numpy as np

from kedge.core.beliefs import Gaussian
from kedge.core.verdicts import Verdict
from kedge.estimation.rows import CONTROL, REPLAYED, VERDICT, AnswerForm
from kedge.estimation.step import Outcome


class Answer:
    """What an event led to; its parts are made of the words of its row when asked for."""

    __slots__ = ("_form", "_words")

    def __init__(self, form: AnswerForm, words: np.ndarray):
        self._form, self._words = form, words

    @property
    def row(self) -> np.ndarray:
        """All of it, as a structured array of one row."""
        return self._words.view(self._form.dtype)

    @property
    def verdict(self) -> Verdict:
        """What became of the reading, or why the whole event changed nothing."""
        return Verdict(int(self._words[VERDICT]))

    @property
    def control(self) -> Verdict:
        """What became of the control: FUSED if it holds from now on."""
        return Verdict(int(self._words[CONTROL]))

    @property
    def replayed(self) -> int:
        """How many events were done again, since this one came late."""
        return int(self._words[REPLAYED])

    @property
    def moments(self) -> Gaussian:
        """The estimate after the newest event, in the light of this one."""
        return self._form.tree(self.row[0])

    @property
    def outcome(self) -> Outcome:
        """Residual, NIS, threshold and all else of the reading."""
        return self._form.outcome(self.row[0])

    def __repr__(self) -> str:
        control = "" if self.control == Verdict.NONE else f", control {self.control.name}"
        return f"Answer({self.verdict.name}{control}, replayed {self.replayed}, {self.moments})"


class Event(NamedTuple):
    """A message of a driver, to be pushed with others; as in :meth:`kedge.Estimator.push`."""

    time: Any
    sensor: str | None = None
    measurement: Any = None
    control: Any = None
    target: Any = 0
    cov: Any = None
    sequence: int = 0
