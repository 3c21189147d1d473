"""What an online estimator remembers: the events of its window, and how some left it."""

import bisect
from typing import NamedTuple

import numpy as np

Order = tuple[int, int, int]
"""What events are sorted by, whatever the order in which they arrive: time in ns, turn among
events at one time as in a log (controls, sensors as installed, the rest), turn among readings of
one sensor at one time."""


class Origin(NamedTuple):
    """What an estimator knows before the first event of its window."""

    time: int
    """ns"""
    words: np.ndarray
    held: np.ndarray
    """The control that holds."""


class Window:
    """The events of the last ``lag`` ns in the order of their times.

    They lie side by side in lists: their order, their rows, the control that they brought, and
    the words after them, where a call of the kernel ended there. ``origin`` is the state before
    the first of them, so that any of them can be replayed.
    """

    def __init__(self, origin: Origin, lag: int, capacity: int):
        self.origin, self.lag, self.capacity = origin, lag, capacity
        self.orders: list[Order] = []
        self.rows: list[np.ndarray] = []
        self.told: list[np.ndarray | None] = []
        self.words: list[np.ndarray | None] = []
        self.closed = origin.time - 1
        """ns of the newest event that is forgotten: what is as old can be taken in no more."""

    @property
    def time(self) -> int:
        """That of the newest event, in ns."""
        return self.orders[-1][0] if self.orders else self.origin.time

    @property
    def after(self) -> np.ndarray:
        """The words after the newest event."""
        last = self.words[-1] if self.words else None
        return self.origin.words if last is None else last

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
        if row["sensor"][0] < 0 and not row["has_control"][0]:
            return False  # it only asks for the estimate
        said = None
        for place in range(len(self.orders) - 1, -1, -1):
            if self.orders[place][0] < order[0]:
                return False
            if self.orders[place] == order:
                said = _said(row) if said is None else said
                if said == _said(self.rows[place]):
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
        for control in reversed(self.told[:place]):
            if control is not None:
                return control
        return self.origin.held

    def append(
        self, order: Order, row: np.ndarray, told: np.ndarray | None, words: np.ndarray | None
    ) -> None:
        """One event more, newer than all others."""
        self.orders.append(order)
        self.rows.append(row)
        self.told.append(told)
        self.words.append(words)

    def insert(
        self, place: int, order: Order, row: np.ndarray, told: np.ndarray | None
    ) -> None:
        """One event between others; the words after it have to be found."""
        self.orders.insert(place, order)
        self.rows.insert(place, row)
        self.told.insert(place, told)
        self.words.insert(place, None)

    def first(self) -> int:
        """The first event that is remembered: those before it only lead to it."""
        opens = (self.time - self.lag,)
        keep = bisect.bisect_left(self.orders, opens)
        return max(keep, len(self.orders) - self.capacity)

    def forget(self) -> None:
        """Drop what is too old, as far back as is known how it left the estimator."""
        keep = 0
        opens = self.time - self.lag
        orders = self.orders
        while orders[keep][0] < opens:
            keep += 1
        keep = max(keep, len(orders) - self.capacity)
        if not keep:
            return
        time, rank, _ = orders[keep - 1]
        if time > self.origin.time or self.rows[keep - 1]["sensor"][0] >= 0:
            self.closed = max(self.closed, time)
        begin, words = self.before(keep)
        if begin:
            self.origin = Origin(orders[begin - 1][0], words, self.held(begin))
            for part in (self.orders, self.rows, self.told, self.words):
                del part[:begin]


def _said(row: np.ndarray) -> list[bytes]:
    names = ["sensor", "has_cov", "has_control"]
    if row["sensor"][0] >= 0:
        names += ["target", "measurement"]
    if row["has_cov"][0]:
        names.append("cov")
    if row["has_control"][0]:
        names.append("control")
    return [row[name].tobytes() for name in names]
