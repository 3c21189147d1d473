"""What an online estimator remembers: the events of its window, and how each left it."""

import bisect
from typing import Any, NamedTuple

import jax
import numpy as np

from kedge.estimation.log import Readings
from kedge.estimation.step import FilterState, Outcome


class Event(NamedTuple):
    """One event as it was pushed."""

    time: float
    rank: int
    """Its turn among events at one time, as in a log: controls, sensors as installed, rest."""
    sequence: int
    """Its turn among readings of one sensor at one time."""
    reading: Readings | None = None
    control: Any = None
    """Held from here on."""

    @property
    def order(self) -> tuple[float, int, int]:
        """What events are sorted by, whatever the order in which they arrive."""
        return self.time, self.rank, self.sequence

    def repeats(self, other: "Event") -> bool:
        """Whether it says again what another one has said: a message delivered twice."""
        if self.order != other.order:
            return False
        if self.reading is None and self.control is None:
            return False  # it only asks for the estimate
        mine, theirs = (jax.tree.leaves((e.reading, e.control)) for e in (self, other))
        return len(mine) == len(theirs) and all(
            np.asarray(a).tobytes() == np.asarray(b).tobytes()
            for a, b in zip(mine, theirs, strict=True)
        )


class State(NamedTuple):
    """All that an estimator knows after an event."""

    filter: FilterState
    time: float
    """That of the filter's state, with all its digits whatever the type of the arrays."""
    control: Any
    words: Any = None
    """The same for machine code, which then need not put it together again."""


class Entry(NamedTuple):
    """An event, and how it left the estimator."""

    event: Event
    after: State
    outcome: Outcome
    record: Any
    """What the smoother needs of the prediction; None if the filter cannot be smoothed."""
    moments: Any = None
    """Mean and covariance after it, where they are known already."""


class Window:
    """The events of the last ``lag`` seconds in the order of their times.

    ``origin`` is the state before the first of them, so that any of them can be replayed.
    """

    def __init__(self, origin: State, lag: float, capacity: int):
        self.origin = origin
        self.lag = lag
        self.capacity = capacity
        self.entries: list[Entry] = []

    @property
    def newest(self) -> State:
        """The state after the last event."""
        return self.entries[-1].after if self.entries else self.origin

    def too_late(self, time: float) -> bool:
        """Whether an event of that time can be taken in no more."""
        if time < max(self.newest.time - self.lag, self.origin.time):
            return True
        state = self.origin.filter
        return time <= self.origin.time and int(state.predictions) + int(state.readings) > 0

    def place(self, event: Event) -> int:
        """Where an event belongs: behind all that come before it or at its turn."""
        if self.lag == 0 and event.time == self.newest.time:
            return len(self.entries)  # as they come
        return bisect.bisect_right(self.entries, event.order, key=lambda e: e.event.order)

    def before(self, index: int) -> State:
        """The state from which the event at ``index`` starts."""
        return self.entries[index - 1].after if index else self.origin

    def holds(self, event: Event) -> bool:
        """Whether an event has been here already."""
        first = bisect.bisect_left(self.entries, event.time, key=lambda e: e.event.time)
        for entry in self.entries[first:]:
            if entry.event.time != event.time:
                return False
            if event.repeats(entry.event):
                return True
        return False

    def replace(self, index: int, entries: list[Entry]) -> None:
        """Put new entries in place of those from ``index`` on; drop what is too old."""
        self.entries[index:] = entries
        opens = self.newest.time - self.lag
        keep = bisect.bisect_left(self.entries, opens, key=lambda e: e.event.time)
        keep = max(keep, len(self.entries) - self.capacity)
        if keep > 0:
            self.origin = self.entries[keep - 1].after
            del self.entries[:keep]
