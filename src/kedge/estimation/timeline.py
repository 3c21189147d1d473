"""The events of an estimator in the order of their times, and the step over those that wait."""

from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from kedge.core.beliefs import Gaussian
from kedge.core.verdicts import Verdict
from kedge.estimation.delayed import Order, Window
from kedge.estimation.live_steps import BATCH, Steps
from kedge.estimation.log import SECOND
from kedge.estimation.rows import NO_SENSOR
from kedge.estimation.smoother import backward

Told = np.ndarray | None
"""The control that an event brings, as a vector."""
FUSED, NONE = int(Verdict.FUSED), int(Verdict.NONE)


class Timeline:
    """Does events that stand in the first rows of ``steps``; late ones where they belong.

    What it returns are the words of answers, which stand until the next call.
    """

    def __init__(
        self,
        steps: Steps,
        window: Window,
        start: int,
        newest: np.ndarray,
        heard: dict[int, int],
    ):
        self.steps, self.window = steps, window
        self.time, self.after, self.held = (
            window.origin.time,
            window.origin.words,
            window.held(0),
        )
        """ns, words and control after the newest event."""
        self._start, self._silence = start, steps.form.silence
        self.newest, self.heard = newest, heard
        """An answer that holds the newest moments; by rank of some sensors the ns of the last
        reading that was fused."""
        self._words, self._rows, self._answers = steps.row_words, steps.rows, steps.answer_words
        names: Any = steps.rows.dtype.names
        self._field = {name: steps.rows[name] for name in names}
        self._at, self._seconds, self._since, self._row, self._held = (
            steps.rows[name] for name in ("time", "seconds", "since", "row", "held")
        )
        self._control, self._replayed, self._told_at = (
            steps.answers[name] for name in ("control", "replayed", "time")
        )

    def one(self, order: Order, told: Told, horizon: float) -> tuple[np.ndarray, bool]:
        """The event in the first row: its answer, and whether it was done."""
        time, window = order[0], self.window
        if time > self.time:
            if time - self.time > horizon:
                return self.refused(Verdict.FUTURE), False
            return self._append_one(order, told), True
        if window.too_late(time):
            return self.refused(Verdict.LATE), False
        if window.holds(order, self._words[0]):
            return self.refused(Verdict.DUPLICATE), False
        place = window.place(order)
        if place == len(window.orders):
            return self._append_one(order, told), True
        return self._insert(place, order, told), True

    def refused(self, verdict: Verdict) -> np.ndarray:
        """The answer to an event that changes nothing."""
        # By NumPy alone: to refuse is not to cost more than to fuse.
        row = self._silence.copy()
        row["verdict"] = row["control"] = int(verdict)
        row["moments"] = self.newest.view(row.dtype)["moments"]
        return row.view(np.int64)

    def in_order(self, orders: Sequence[Order], place: int, gap: float) -> int:
        """The end of the events from ``place`` on that one call does: each behind the last."""
        window = self.window
        last: Order = (self.time, -2, 0)
        if window.orders:  # without a lag those of one time stand as they came
            last = window.orders[-1] if window.lag else max(window.orders)
        most = min(len(orders), place + BATCH)
        if orders[place][0] <= window.closed:
            return place
        for end in range(place, most):
            order = orders[end]
            if order <= last or order[0] - last[0] > gap:
                return end
            last = order
        return most

    def append(self, orders: Sequence[Order], told: Sequence[Told]) -> np.ndarray:
        """The first rows done, each behind the last."""
        window, count = self.window, len(orders)
        newest, held = self.time, self.held
        for i, (order, control) in enumerate(zip(orders, told, strict=True)):
            self._between(i, newest, order[0], held)
            newest, held = order[0], held if control is None else control
        trail = self.steps.run(count, self.after)
        words = [None] * (count - len(trail)) + trail
        rows = self._words[:count].copy()
        for i, order in enumerate(orders):
            window.append(order, rows[i], told[i], words[i])
        self.time, self.held, self.after = newest, held, trail[-1]
        window.forget()
        self._control[:count], self._replayed[:count] = NONE, 0
        self._told_at[:count] = self._at[:count]
        answers = self._answers[:count]
        self.newest = answers[-1].copy()
        self._hear(count)
        return answers

    def _append_one(self, order: Order, told: Told) -> np.ndarray:
        time, window = order[0], self.window
        self._between(0, self.time, time, self.held)
        after = self.steps.run(1, self.after)[0]
        window.append(order, self._words[0].copy(), told, after)
        if told is not None:
            self.held = told
        self.time, self.after = time, after
        if len(window.orders) > window.full:
            window.forget()
        self._control[0], self._replayed[0], self._told_at[0] = NONE, 0, time
        self.newest = answer = self._answers[0].copy()
        if self.heard:
            self._hear(1)
        return answer

    def _insert(self, place: int, order: Order, told: Told) -> np.ndarray:
        """A late event put where it belongs, and what follows done again."""
        window = self.window
        self._at[0] = order[0]
        begin, words = window.before(place)
        window.insert(place, order, self._words[0].copy(), told)
        carried: list[Told] = []
        answer, newest, heard = self.newest, self.newest, dict(self.heard)
        try:
            for start in range(begin, len(window.orders), BATCH):
                count = self._gather(start)
                trail = self.steps.run(count, words)
                carried += [None] * (count - len(trail)) + trail
                words = trail[-1]
                if start <= place < start + count:
                    answer = self._answers[place - start].copy()
                newest = self._answers[count - 1].copy()
                self._hear(count)
        except BaseException:
            window.remove(place)
            self.heard.update(heard)
            raise
        window.words[begin:] = carried
        self.after, self.held, self.newest = words, window.held(len(window.orders)), newest
        row = answer.view(self._silence.dtype)
        row["moments"] = newest.view(row.dtype)["moments"]
        row["replayed"], row["time"] = len(window.orders) - 1 - place, order[0]
        row["control"] = NONE
        window.forget()
        return answer

    def peek(self, time: int) -> np.ndarray:
        """The answer to an event at which nothing happens, and which never was."""
        self._field["sensor"][0], self._field["has_cov"][0] = NO_SENSOR, 0
        self._between(0, self.time, time, self.held)
        self.steps.run(1, self.after)
        return self._answers[0].copy()

    def recorded(self) -> Iterator[tuple[int, Gaussian, Any]]:
        """ns, estimate and what a smoother needs, of each event of the window."""
        window, words = self.window, self.window.origin.words
        for start in range(0, len(window.orders), BATCH):
            count = self._gather(start)
            words = self.steps.record(count, words)
            for i, pair in enumerate(self.steps.to_smooth(count)):
                yield window.orders[start + i][0], *pair

    def smoothed(self) -> list[tuple[int, Gaussian]]:
        """The events of the window in the light of all readings, by their ns."""
        beliefs: list[tuple[int, Gaussian]] = []
        later: Any = None
        for time, filtered, record in reversed(list(self.recorded())[self.window.first() :]):
            smooth = filtered
            if later is not None:
                smooth = _backward(filtered, beliefs[-1][1], later)
            beliefs.append((time, smooth))
            later = record
        return beliefs[::-1]

    def ready(self) -> None:
        """Compile all that can come."""
        self.steps.prepare()
        if self.steps.smoothable:
            self.peek(self.time)  # leaves an event without a reading in the first row
            self.steps.record(1, self.after)
            ((moments, record),) = self.steps.to_smooth(1)
            _backward(moments, _backward(moments, moments, record), record)

    def _hear(self, count: int) -> None:
        """Remember when something was last fused of the sensors that must not fall silent."""
        if not self.heard:
            return
        rows, verdicts = self.steps.rows[:count], self.steps.answers["verdict"][:count]
        for rank, time, verdict in zip(
            rows["sensor"].tolist(), rows["time"].tolist(), verdicts.tolist(), strict=True
        ):
            if verdict == FUSED and rank in self.heard:
                self.heard[rank] = max(self.heard[rank], time)

    def _gather(self, begin: int) -> int:
        """Events of the window from ``begin`` on in the first rows; how many they are."""
        window = self.window
        rows = window.rows[begin : begin + BATCH]
        count = len(rows)
        np.concatenate(rows, out=self._words[:count].reshape(-1))
        newest = window.orders[begin - 1][0] if begin else window.origin.time
        held = window.held(begin)
        for i in range(count):
            time, told = window.orders[begin + i][0], window.told[begin + i]
            self._between(i, newest, time, held)
            newest, held = time, held if told is None else told
        return count

    def _between(self, place: int, since: int, time: int, held: np.ndarray) -> None:
        """What the row at ``place`` says of the time until its event."""
        self._seconds[place], self._held[place] = (time - self._start) / SECOND, held
        self._since[place], self._row[place] = (since - self._start) / SECOND, place
        self._at[place] = time


_backward = eqx.filter_jit(backward)
