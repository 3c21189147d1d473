"""The events of an estimator in the order of their times, and the step over those that wait."""

from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from kedge.core.beliefs import Gaussian
from kedge.core.verdicts import Verdict
from kedge.estimation.admission import Admitted
from kedge.estimation.delayed import Order, Window
from kedge.estimation.live_steps import BATCH, Steps, Trail
from kedge.estimation.log import SECOND
from kedge.estimation.rows import CONTROL, NO_SENSOR, REPLAYED, VERDICT
from kedge.estimation.smoother import backward

FEW = 6
"""Controls that are put into rows one by one sooner than all at once."""
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
        self._start, self._numbers = start, np.arange(BATCH)
        self.newest, self.heard = newest, heard
        """An answer that holds the newest moments; by rank of some sensors the ns of the last
        reading that was fused."""
        self._words, self._rows, self._answers = steps.row_words, steps.rows, steps.answer_words
        names: Any = steps.rows.dtype.names
        self._field = {name: steps.rows[name] for name in names}
        self._at, self._seconds, self._since, self._row, self._held = (
            steps.rows[name] for name in ("time", "seconds", "since", "row", "held")
        )
        self._brought = steps.rows["control"]
        self._control, self._replayed, self._answered = (
            steps.answers[name] for name in ("control", "replayed", "time")
        )

    def one(self, event: Admitted, horizon: float) -> tuple[np.ndarray, bool]:
        """The event in the first row: its answer, and whether it was done."""
        order, _, fate = event
        time, window = order[0], self.window
        if time > self.time:
            if time - self.time > horizon:
                return self._refused(Verdict.FUTURE, fate), False
            return self._append_one(event), True
        if window.too_late(time):
            return self._refused(Verdict.LATE, fate), False
        if window.holds(order, self._words[0]):
            return self._refused(Verdict.DUPLICATE, fate), False
        place = window.place(order)
        if place == len(window.orders):
            return self._append_one(event), True
        return self._insert(place, event), True

    def _refused(self, verdict: Verdict, fate: int) -> np.ndarray:
        # By NumPy alone: to refuse is not to cost more than to fuse.
        row, moments = self.steps.form.quiet.copy(), self.steps.form.moments
        row[VERDICT], row[CONTROL] = verdict, NONE if fate == NONE else verdict
        row[moments] = self.newest[moments]
        return row

    def in_order(self, events: Sequence[Admitted], place: int, gap: float) -> int:
        """The end of the events from ``place`` on that one call does: each behind the last."""
        window = self.window
        last: Order = (self.time, -2, 0)
        if window.orders:  # without a lag those of one time stand as they came
            last = window.orders[-1] if window.lag else max(window.orders)
        most = min(len(events), place + BATCH)
        if events[place][0][0] <= window.closed:
            return place
        for end in range(place, most):
            order = events[end][0]
            if order <= last or order[0] - last[0] > gap:
                return end
            last = order
        return most

    def append(self, events: Sequence[Admitted]) -> np.ndarray:
        """The first rows done, each behind the last."""
        window, count = self.window, len(events)
        orders, controls, fates = zip(*events, strict=True)
        times = [order[0] for order in orders]
        self._at[:count] = times
        held = self._follow(self.time, controls, self.held)
        trail = self.steps.run(count, self.after)
        window.extend(orders, list(self._words[:count].copy()), controls, trail)
        self.time, self.held, self.after = times[-1], held, trail[-1]
        if len(window.orders) > window.full:
            window.forget()
        answers = self._answers[:count]
        self._control[:count], self._replayed[:count], self._answered[:count] = fates, 0, times
        self.newest = answers[-1].copy()
        if self.heard:
            self._hear(count)
        return answers

    def _append_one(self, event: Admitted) -> np.ndarray:
        (order, control, fate), window = event, self.window
        time = order[0]
        self._between(0, self.time, time, self.held)
        after = self.steps.run(1, self.after)[0]
        window.append(order, self._words[0].copy(), control, after)
        if control is not None:
            self.held = control
        self.time, self.after = time, after
        if len(window.orders) > window.full:
            window.forget()
        self._control[0], self._replayed[0], self._answered[0] = fate, 0, time
        self.newest = answer = self._answers[0].copy()
        if self.heard:
            self._hear(1)
        return answer

    def _insert(self, place: int, event: Admitted) -> np.ndarray:
        """A late event put where it belongs, and what follows done again."""
        (order, control, fate), window = event, self.window
        self._at[0] = order[0]
        begin, words = window.before(place)
        window.insert(place, order, self._words[0].copy(), control)
        carried: Trail = []
        answer, newest, heard = self.newest, self.newest, dict(self.heard)
        try:
            for start in range(begin, len(window.orders), BATCH):
                count = self._gather(start)
                trail = self.steps.run(count, words)
                carried += trail
                words = trail[-1]
                self._answered[:count] = self._at[:count]
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
        moments = self.steps.form.moments
        answer[CONTROL], answer[REPLAYED] = fate, len(window.orders) - 1 - place
        answer[moments] = newest[moments]
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
        self._follow(newest, window.controls[begin : begin + count], window.held(begin))
        return count

    def _follow(self, newest: int, controls: Sequence[Any], held: np.ndarray) -> np.ndarray:
        """:meth:`_between` for events that follow each other; the control after the last."""
        count, seconds = len(controls), self._seconds
        seconds[:count] = (self._at[:count] - self._start) / SECOND
        self._since[0] = float(newest - self._start) / SECOND
        self._since[1:count] = seconds[: count - 1]
        self._row[:count], self._held[:count] = self._numbers[:count], held
        places = [place for place, control in enumerate(controls) if control is not None]
        if len(places) <= FEW:
            for place in places:
                self._held[place + 1 : count] = controls[place]
        else:
            before = np.searchsorted(places, self._numbers[:count])  # how many came earlier
            later = before > 0
            self._held[:count][later] = self._brought[np.take(places, before[later] - 1)]
        if places:
            held = controls[places[-1]]
        return held

    def _between(self, place: int, since: int, time: int, held: np.ndarray) -> None:
        """What the row at ``place`` says of the time until its event."""
        # Rounded as an array of them is.
        self._seconds[place] = float(time - self._start) / SECOND
        self._since[place] = float(since - self._start) / SECOND
        self._held[place], self._row[place] = held, place
        self._at[place] = time


_backward = eqx.filter_jit(backward)
