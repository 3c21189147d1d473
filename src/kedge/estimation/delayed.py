"""What an online estimator remembers: the events of its window, and how some left it."""

import bisect
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from kedge.estimation.rows import HAS_CONTROL, NO_SENSOR, SENSOR

Order = tuple[int, int, int]
"""What events are sorted by, in whatever order they arrive: time in ns, turn among those of one
time as in a log (controls, sensors as installed, the rest), turn among readings of a sensor."""

SPARE = 32
"""Events beyond the window: to forget each as it gets old costs more than to wait."""


class Origin(NamedTuple):
    """What an estimator knows before the first event of its window."""

    time: int
    """ns"""
    words: np.ndarray
    held: np.ndarray
    """The control that holds."""


class Window:
    """The events of the last ``lag`` ns in the order of their times.

    They lie side by side in lists: their order, the words of their rows, the control that they
    brought, and the words that are carried after them, where a call of the kernel ended there.
    ``origin`` is the state before the first of them, so that any of them can be replayed.
    """

    def __init__(
        self,
        origin: Origin,
        lag: int,
        capacity: int,
        content: Callable[[np.ndarray], bytes] = np.ndarray.tobytes,
    ):
        self.origin, self.lag, self.capacity, self._content = origin, lag, capacity, content
        self.orders: list[Order] = []
        self.rows: list[np.ndarray] = []
        self.controls: list[np.ndarray | None] = []
        self.words: list[np.ndarray | None] = []
        self.closed = origin.time - 1
        """ns of the newest event that is forgotten: what is as old can be taken in no more."""
        self.full = min(SPARE, capacity)
        """Events from which on it is time to forget."""

    @property
    def time(self) -> int:
        """That of the newest event, in ns."""
        return self.orders[-1][0] if self.orders else self.origin.time

    def too_late(self, time: int) -> bool:
        """Whether an event of that time can be taken in no more."""
        return time <= self.closed or time < self.time - self.lag

    def place(self, order: Order) -> int:
        """Where an event belongs: behind all that come before it or at its turn."""
        if self.lag == 0 and order[0] == self.time:
            return len(self.orders)  # as they come
        return bisect.bisect_right(self.orders, order)

    def holds(self, order: Order, row: np.ndarray) -> bool:
        """Whether an event has been here already: a message delivered twice."""
        if row[SENSOR] == NO_SENSOR and not row[HAS_CONTROL]:
            return False  # it only asks for the estimate
        for place in range(len(self.orders) - 1, -1, -1):
            if self.orders[place][0] < order[0]:
                return False
            same_turn = self.orders[place] == order
            if same_turn and self._content(row) == self._content(self.rows[place]):
                return True
        return False

    def before(self, place: int) -> tuple[int, np.ndarray]:
        """Where the last call before the event at ``place`` ended, and its words."""
        for begin in range(place, 0, -1):
            words = self.words[begin - 1]
            if words is not None:
                return begin, words
        return 0, self.origin.words

    def held(self, place: int) -> np.ndarray:
        """The control that holds when the event at ``place`` comes."""
        for control in reversed(self.controls[:place]):
            if control is not None:
                return control
        return self.origin.held

    def append(
        self,
        order: Order,
        row: np.ndarray,
        control: np.ndarray | None,
        words: np.ndarray | None,
    ) -> None:
        """One event more, newer than all others."""
        self.orders.append(order)
        self.rows.append(row)
        self.controls.append(control)
        self.words.append(words)

    def extend(self, orders: Any, rows: Any, controls: Any, words: Any) -> None:
        """Events more, newer than all others."""
        self.orders.extend(orders)
        self.rows.extend(rows)
        self.controls.extend(controls)
        self.words.extend(words)

    def insert(
        self, place: int, order: Order, row: np.ndarray, control: np.ndarray | None
    ) -> None:
        """One event between others; the words after it have to be found."""
        self.orders.insert(place, order)
        self.rows.insert(place, row)
        self.controls.insert(place, control)
        self.words.insert(place, None)

    def remove(self, place: int) -> None:
        """Undo :meth:`insert`."""
        for part in (self.orders, self.rows, self.controls, self.words):
            del part[place]

    def first(self) -> int:
        """The first event that is remembered: those before it only lead to it."""
        opens = (self.time - self.lag,)
        keep = bisect.bisect_left(self.orders, opens)
        return max(keep, len(self.orders) - self.capacity)

    def forget(self) -> None:
        """Drop what is too old, as far back as is known how it left the estimator."""
        keep, orders = self.first(), self.orders
        self.full = min(len(orders) - keep + SPARE, self.capacity)
        if not keep:
            return
        time = orders[keep - 1][0]
        if time > self.origin.time or self.rows[keep - 1][SENSOR] != NO_SENSOR:
            self.closed = max(self.closed, time)
        begin, words = self.before(keep)
        if begin:
            self.origin = Origin(orders[begin - 1][0], words, self.held(begin))
            for part in (self.orders, self.rows, self.controls, self.words):
                del part[:begin]
