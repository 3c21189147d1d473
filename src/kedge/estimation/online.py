"""Online estimation: the same step over the events that wait, behind a small stateful object."""

import math
import threading
from collections.abc import Iterable, Iterator
from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError, DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.admission import NS, Admission, nanoseconds, numbers
from kedge.estimation.answer import Answer, Event
from kedge.estimation.clipping import beyond
from kedge.estimation.compiled import Engine
from kedge.estimation.delayed import Order, Origin, Window
from kedge.estimation.live_steps import BATCH, Steps, begin_live
from kedge.estimation.log import SECOND, Log
from kedge.estimation.native_step import NativeSteps, NotCompiled
from kedge.estimation.rig import Rig, as_arrays, check_step
from kedge.estimation.rows import NO_SENSOR, EventForm
from kedge.estimation.smoother import backward
from kedge.estimation.traced_step import TracedSteps
from kedge.estimation.transition import require_smoothable

DAY = 86_400 * SECOND
"""ns after its start beyond which the first event of an estimator is none of its clock."""
FUSED, NONE = int(Verdict.FUSED), int(Verdict.NONE)


class Estimator:
    """Feed events as they come; read the belief at any moment.

    A control holds from its time on; until the first, ``control`` does, or nothing. One that
    is not finite does not hold: the one before does.

    A sensor of which nothing is fused for longer than its ``allowed_silence`` makes the
    estimate ``degraded``; it goes on by what the others and the vehicle's motion tell.

    Events of the last ``lag`` seconds may come in any order: the estimator goes back to where
    a late one belongs and does again what follows, so the belief is that of the run in which
    all came in time. What is older changes nothing and gets the verdict LATE. A message that
    comes twice gets DUPLICATE; one stamped more than ``horizon`` seconds ahead gets FUTURE,
    since it would make everything after it late. At most ``capacity`` events are remembered.

    Times are seconds of any clock, or with ``clock="ns"`` whole nanoseconds, of which floats
    lose the last digits; within, they are whole nanoseconds. ``start`` is the prior's, 0 unless
    it is given. An estimator belongs to the thread of its first event.

    Raises:
        DataError: a setting or the first control is of no use.
        ContractError: the control is that of another vehicle, or ``engine`` cannot run this.
    """

    def __init__(
        self,
        filter: AbstractFilter,
        rig: Rig,
        key: PRNGKeyArray | None = None,
        start: float | None = None,
        control: Any = None,
        lag: float = 0.0,
        horizon: float = math.inf,
        capacity: int = 10_000,
        engine: Engine = "auto",
        clock: Literal["s", "ns"] = "s",
    ):
        for name, value, good in (
            ("lag", lag, 0 <= lag < math.inf),
            ("horizon", horizon, horizon > 0),
            ("capacity", capacity, capacity >= 1),
            ("clock", clock, clock in ("s", "ns")),
        ):
            if not good:
                raise DataError(f"estimator: {name} is {value}, expected {_EXPECTED[name]}")
        key = jax.random.key(0) if key is None else key
        self._filter, self._rig = as_arrays((filter.bind_sensors(rig.names), rig))
        # An attribute of a module costs as much as an event.
        self._names, self._vehicle = rig.names, rig.vehicle
        self._ranks = {name: rank for rank, name in enumerate(self._names)}
        self._unit = NS if clock == "ns" else 1.0
        self._start = 0 if start is None else nanoseconds(start, self._unit)
        self._horizon = horizon * SECOND
        self._knows_start, self._thread = start is not None, 0
        self._longest = rig.vehicle.longest_step() * SECOND
        # By rank: the silence that is allowed, and when the sensor was last heard, in ns.
        silences = {rank: one.allowed_silence for rank, one in enumerate(rig.sensors)}
        self._allowed = {rank: s * SECOND for rank, s in silences.items() if s is not None}
        self._heard = dict.fromkeys(self._allowed, self._start)
        self._limits = rig.vehicle.control_limits()
        self.clipped: dict[str, int] = {}
        """How often a component of the control was told beyond its limit; it acts as that."""
        still = jax.tree.map(_floats, rig.vehicle.nominal_control(0.0))
        self._form, state = EventForm(rig, still), begin_live(self._filter, self._rig, key)
        self._steps: Steps = _steps(self._filter, self._rig, self._form, state, key, engine)
        self._rows, self._answers = self._steps.rows, self._steps.answers
        self._field = {name: self._rows[name] for name in self._form.dtype.names or ()}
        self._result = {name: self._answers[name] for name in ("control", "replayed", "time")}
        self._admission = Admission(rig, self._form, self._rows, still)
        held: Any = np.zeros_like(self._rows["held"][0])
        if control is not None:
            held = self._admission.control(control)
            if held is None:
                raise DataError(f"the control: found {control}, expected finite numbers")
        origin = Origin(self._start, self._steps.pack(state), held)
        self._window = Window(origin, round(lag * SECOND), capacity)
        self._held, self._newest = held, self._steps.first_answer(state)
        self._state: tuple[Any, Any] = origin.words, state

    @property
    def belief(self) -> Any:
        """What the filter believes after the newest event."""
        words = self._window.after
        if words is not self._state[0]:
            self._state = words, self._steps.unpack(words)
        return self._state[1].belief

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors of its rig."""
        return self._names

    @property
    def time(self) -> float:
        """Time of the newest event, as its clock counts."""
        return self._told(self._window.time)

    @property
    def degraded(self) -> tuple[str, ...]:
        """Sensors of which nothing was fused for longer than their ``allowed_silence``."""
        now = self._window.time
        return tuple(
            self._names[rank]
            for rank, allowed in self._allowed.items()
            if now - self._heard[rank] > allowed
        )

    def ready(self) -> None:
        """Compile all that can come; afterwards nothing compiles."""
        self._steps.prepare()
        if self._steps.smoothable:
            self.peek(self.time)  # leaves an event without a reading in the first row
            self._steps.record(1, self._window.after)
            ((moments, record),) = self._steps.to_smooth(1)
            _backward(moments, moments, record)

    def push(
        self,
        time: float,
        sensor: str | None = None,
        measurement: Any = None,
        *,
        control: Any = None,
        target: Any = 0,
        cov: Any = None,
        sequence: int = 0,
    ) -> Answer:
        """Advance to ``time``, use a reading if one is given, then hold a new control.

        ``target`` is a row of the sensor's map, ``cov`` the covariance of this one reading.
        ``sequence`` orders readings of one sensor at one time that may arrive in any order.

        Raises:
            DataError: the time is not finite, or the first one is far from ``start``; something
                holds no numbers, or those of another shape.
            ContractError: the rig has no such sensor, a reading or control is of another
                class, or the step is longer than the vehicle's stays stable: tell it of times
                in between. Another thread has pushed before.
        """
        if threading.get_ident() != self._thread:
            self._belongs_here()
        order, told, fate = self._write(
            time, sensor, measurement, control, target, cov, sequence
        )
        return Answer(self._steps.form, self._one(order, told, fate))

    def push_many(self, events: Iterable[Event] | np.ndarray) -> np.ndarray:
        """Push events that wait, in their order; a row of the answers for each.

        The answers are those of as many calls of :meth:`push`, to the bit. Where the events
        follow each other in time one call of the kernel does them all. ``events`` may be rows
        of :meth:`rows` as well, which cost less; :meth:`answers` makes objects of the result.

        Raises:
            DataError: as for :meth:`push`; then none of the events is used.
            ContractError: likewise; but a step that is too long is met when those before it
                have been done.
        """
        self._belongs_here()
        rows = events if isinstance(events, np.ndarray) else self.rows(events)
        orders, told, fates = self._checked(rows)
        rows = rows.copy()
        rows["has_control"] = [control is not None for control in told]
        answers, place, count = np.zeros(len(rows), self._answers.dtype), 0, len(rows)
        while place < count:
            end = self._in_order(orders, place)
            if end == place:
                self._rows[:1] = rows[place : place + 1]
                answers[place] = self._one(orders[place], told[place], fates[place])[0]
                place += 1
                continue
            self._rows[: end - place] = rows[place:end]
            part = self._append(orders[place:end], told[place:end])
            answers[place:end] = part
            answers["control"][place:end] = fates[place:end]
            place = end
        return answers

    def rows(self, events: Iterable[Event]) -> np.ndarray:
        """Events as rows of a structured array, for :meth:`push_many`.

        Times are in ns, sensors by their place in :attr:`sensors` (-1 for none); measurement,
        control and covariance are vectors of numbers, padded with zeros.

        Raises:
            DataError: as for :meth:`push`.
            ContractError: likewise.
        """
        written = []
        for event in events:
            given, knows = Event(*event), self._knows_start
            order, _, fate = self._write(*given)
            self._knows_start = knows
            row = self._rows[:1].copy()
            row["time"], row["has_control"] = order[0], fate != NONE
            written.append(row)
        return np.concatenate(written) if written else self._form.blank(0)

    def answers(self, rows: np.ndarray) -> list[Answer]:
        """Objects of what :meth:`push_many` returned."""
        return [Answer(self._steps.form, rows[i : i + 1]) for i in range(len(rows))]

    def peek(self, time: float) -> Gaussian:
        """What it will believe at ``time`` if nothing comes until then; nothing changes.

        Raises:
            DataError: the time is not finite, or before that of the newest event.
            ContractError: another thread pushes.
        """
        self._belongs_here()
        at, newest = nanoseconds(time, self._unit), self._window.time
        if at < newest:
            raise DataError(
                f"peek at {time:.10g} {_CLOCKS[self._unit]}: the newest event is at "
                f"{self.time:.10g} {_CLOCKS[self._unit]} already"
            )
        self._field["sensor"][0], self._field["has_cov"][0] = NO_SENSOR, 0
        self._between(0, newest, at, self._held)
        self._steps.run(1, self._window.after)
        return Answer(self._steps.form, self._answers[:1].copy()).moments

    def smoothed(self) -> list[tuple[float, Gaussian]]:
        """The estimates of the window in the light of all its readings: a fixed-lag smoother.

        The first is the most certain about the past: everything of the ``lag`` seconds after
        it has been used.

        Raises:
            ContractError: the filter carries neither a Gaussian nor an ensemble.

        Source: S. Särkkä, "Bayesian Filtering and Smoothing", 2013, sections 8.2 and 10.6.
        """
        require_smoothable(self._filter)
        window, pairs = self._window, []
        words = window.origin.words
        for begin in range(0, len(window.rows), BATCH):
            count = self._gather(begin, window.rows[begin : begin + BATCH])
            words = self._steps.record(count, words)
            pairs += self._steps.to_smooth(count)
        beliefs: list[tuple[float, Gaussian]] = []
        later: Any = None
        remembered = list(zip(window.orders, pairs, strict=True))[window.first() :]
        for (time, *_), (filtered, record) in reversed(remembered):
            if later is not None:
                filtered = _backward(filtered, beliefs[-1][1], later)
            beliefs.append((self._told(time), filtered))
            later = record
        return beliefs[::-1]

    # What is checked before anything is done.

    def _belongs_here(self) -> None:
        """Refuse a second thread, which would write where the first one reads.

        Raises:
            ContractError: the events came from another thread so far.
        """
        if (thread := threading.get_ident()) != self._thread:
            if self._thread:
                raise ContractError(
                    "an estimator belongs to the thread of its first event: push to it from "
                    "there, by a queue, or make one for each thread"
                )
            self._thread = thread

    def _write(
        self, time: Any, sensor: Any, measurement: Any, control: Any, target: Any, cov: Any,
        sequence: int,
    ) -> tuple[Order, np.ndarray | None, int]:  # fmt: skip
        """An event in the first row; its order, the control that will hold, that one's fate."""
        at, field = nanoseconds(time, self._unit), self._field
        rank, place = (len(self._ranks) if control is None else -1), NO_SENSOR
        if sensor is not None:
            known = self._ranks.get(sensor)
            rank = place = self._rig.index(sensor) if known is None else known
            self._admission.reading(rank, measurement, target, cov)
        else:
            field["has_cov"][0] = 0
        told, fate = None, NONE
        if control is not None:
            told = self._admission.control(control)
            fate = FUSED if told is not None else int(Verdict.NOT_FINITE)
        field["sensor"][0], field["has_control"][0] = place, told is not None
        field["sequence"][0] = sequence
        if not self._knows_start:
            self._check_clock(at)
        return (at, rank, sequence), told, fate

    def _checked(self, rows: np.ndarray) -> tuple[list[Order], list[Any], list[int]]:
        """Orders, controls and their fates of rows from outside.

        Raises:
            DataError: they are not rows of this rig.
        """
        if rows.dtype != self._form.dtype or rows.ndim != 1:
            raise DataError(
                f"push_many: found an array of {rows.dtype.name} numbers, expected rows as "
                "Estimator.rows makes them, or events"
            )
        ranks, count = rows["sensor"].tolist(), len(self._names)
        if any(not NO_SENSOR <= rank < count for rank in ranks):
            raise DataError(
                f"push_many: sensor: found {max(ranks)}, expected -1 to {count - 1}"
            )
        finite = np.isfinite(rows["control"]).all(axis=1).tolist()
        orders, told, fates = [], [], []
        for i, (time, sequence, given) in enumerate(
            zip(*(rows[n].tolist() for n in ("time", "sequence", "has_control")), strict=True)
        ):
            if not self._knows_start:
                self._check_clock(time)
            rank = ranks[i] if ranks[i] >= 0 else (-1 if given else count)
            orders.append((time, rank, sequence))
            told.append(rows["control"][i].copy() if given and finite[i] else None)
            fates.append((FUSED if finite[i] else int(Verdict.NOT_FINITE)) if given else NONE)
        return orders, told, fates

    def _check_clock(self, time: int) -> None:
        """Refuse a first event that is of another clock than the start.

        Raises:
            DataError: it is more than a day away.
        """
        if abs(time - self._start) > DAY:
            raise DataError(
                f"the first event is at {self._told(time):.10g} {_CLOCKS[self._unit]}, but the "
                f"estimator starts at 0 {_CLOCKS[self._unit]}: give the time of its prior, as "
                "start="
            )
        self._knows_start = True

    # What is done.

    def _one(self, order: Order, told: np.ndarray | None, fate: int) -> np.ndarray:
        """The event in the first row; a row of its own for the answer."""
        window, time = self._window, order[0]
        newest = window.time
        if time - newest > self._horizon:
            return self._unchanged(Verdict.FUTURE, fate)
        if window.too_late(time):
            return self._unchanged(Verdict.LATE, fate)
        if time > newest:
            if time - newest > self._longest:
                what = f"event at {self._told(time):g} s: the step since the event before"
                check_step(self._vehicle, (time - newest) / SECOND, what)
        elif window.holds(order, self._rows[:1]):
            return self._unchanged(Verdict.DUPLICATE, fate)
        place = window.place(order) if time <= newest else len(window.orders)
        if place == len(window.orders):
            answer = self._append((order,), (told,)).copy()
        else:
            answer = self._insert(place, order, told)
        answer["control"] = fate
        return answer

    def _in_order(self, orders: list[Order], place: int) -> int:
        """The end of the events from ``place`` on that one call can do: each behind the last."""
        window = self._window
        last, most = max(window.orders[-1:], default=(window.time, -2, 0)), len(orders)
        if window.lag == 0 and window.orders:
            last = max(window.orders)
        end, gap = place, min(self._horizon, self._longest)
        while end < min(most, place + BATCH):
            order = orders[end]
            if order <= last or order[0] - last[0] > gap or order[0] <= window.closed:
                break
            last, end = order, end + 1
        return end

    def _append(self, orders: Any, told: Any) -> np.ndarray:
        """The first rows done, each behind the last; the answers' rows, until the next."""
        window, count, field = self._window, len(orders), self._field
        newest, held = window.time, self._held
        for i in range(count):
            time = orders[i][0]
            self._between(i, newest, time, held)
            newest, held = time, held if told[i] is None else told[i]
        trail = self._steps.run(count, window.after)
        known = count - len(trail)
        field["time"][:count] = [order[0] for order in orders]
        for i in range(count):
            words = trail[i - known] if i >= known else None
            window.append(orders[i], self._rows[i : i + 1].copy(), told[i], words)
        window.forget()
        self._held, answers = held, self._answers[:count]
        self._result["control"][:count], self._result["replayed"][:count] = NONE, 0
        self._result["time"][:count] = field["time"][:count]
        self._newest = answers[-1:].copy()
        self._hear(count)
        if self._limits is not None:
            for control in told:
                self._clip(control)
        return answers

    def _insert(self, place: int, order: Order, told: np.ndarray | None) -> np.ndarray:
        """A late event put where it belongs, and what follows done again."""
        window = self._window
        self._field["time"][0] = order[0]
        begin, words = window.before(place)
        window.insert(place, order, self._rows[:1].copy(), told)
        found: list[np.ndarray | None] = []
        answer = newest = self._newest
        heard = dict(self._heard)
        try:
            for start in range(begin, len(window.rows), BATCH):
                count = self._gather(start, window.rows[start : start + BATCH])
                trail = self._steps.run(count, words)
                found += [None] * (count - len(trail)) + trail
                words = trail[-1]
                if start <= place < start + count:
                    answer = self._answers[place - start : place - start + 1].copy()
                newest = self._answers[count - 1 : count].copy()
                self._hear(count)
        except BaseException:
            self._heard = heard
            for part in (window.orders, window.rows, window.told, window.words):
                del part[place]
            raise
        window.words[begin:] = found
        self._held, self._newest = window.held(len(window.rows)), newest
        answer["moments"] = newest["moments"]
        answer["replayed"], answer["time"] = len(window.orders) - 1 - place, order[0]
        window.forget()
        self._clip(told)
        return answer

    def _gather(self, begin: int, rows: list[np.ndarray]) -> int:
        """Events of the window from ``begin`` on in the first rows; how many they are."""
        window, count = self._window, len(rows)
        np.concatenate(rows, out=self._rows[:count])
        newest = window.orders[begin - 1][0] if begin else window.origin.time
        held = window.held(begin)
        for i in range(count):
            time, told = window.orders[begin + i][0], window.told[begin + i]
            self._between(i, newest, time, held)
            newest, held = time, held if told is None else told
        return count

    def _between(self, place: int, since: int, time: int, held: np.ndarray) -> None:
        """What the row at ``place`` says of the time until its event."""
        field, start = self._field, self._start
        field["seconds"][place], field["held"][place] = (time - start) / SECOND, held
        field["since"][place], field["row"][place] = (since - start) / SECOND, place

    def _hear(self, count: int) -> None:
        """Remember when something was last fused of the sensors that must not fall silent."""
        if not self._allowed:
            return
        verdicts, field = self._answers["verdict"], self._field
        for i in range(count):
            rank = int(field["sensor"][i])
            if verdicts[i] == FUSED and rank in self._allowed:
                self._heard[rank] = max(self._heard[rank], int(field["time"][i]))

    def _clip(self, told: np.ndarray | None) -> None:
        if told is not None and self._limits is not None:
            for label in beyond(self._form.control(told), self._limits):
                self.clipped[label] = self.clipped.get(label, 0) + 1

    def _unchanged(self, verdict: Verdict, fate: int) -> np.ndarray:
        # By NumPy alone: to refuse is not to cost more than to fuse.
        row = self._steps.form.silence.copy()
        row["verdict"], row["moments"] = int(verdict), self._newest["moments"]
        row["control"] = NONE if fate == NONE else int(verdict)
        return row

    def _told(self, time: int) -> float:
        """A time as the clock counts."""
        return time if self._unit == NS else time / SECOND


def replay(estimator: Estimator, log: Log) -> Iterator[Answer]:
    """Push the events of a log in their order; one answer for each.

    The estimator must have been made with the log's first control. A control is told when it
    changes.
    """
    time, fired, rows = (np.asarray(part).tolist() for part in log.schedule)
    controls, readings = jax.tree.map(np.asarray, (log.controls, log.readings))
    for i in range(len(time)):
        now, then = (
            jax.tree.map(lambda leaf, at=at: leaf[at], controls)
            for at in (i, min(i + 1, len(time) - 1))
        )
        pairs = zip(jax.tree.leaves(now), jax.tree.leaves(then), strict=True)
        control = None if all(np.array_equal(a, b) for a, b in pairs) else then
        if fired[i] < 0:
            yield estimator.push(time[i], control=control)
            continue
        one = jax.tree.map(lambda leaf, at=rows[i]: leaf[at], readings[fired[i]])
        yield estimator.push(
            time[i],
            estimator.sensors[fired[i]],
            one.measurement,
            control=control,
            target=int(one.target),
            cov=one.cov,
        )


def _steps(
    filter: AbstractFilter, rig: Rig, form: EventForm, state: Any, key: Any, engine: Engine
) -> Steps:
    """The engine asked for, or the one that can."""
    try:
        return NativeSteps(filter, rig, form, state, engine)
    except NotCompiled:
        return TracedSteps(filter, rig, form, state, key)


_CLOCKS = {1.0: "s", NS: "ns"}
_EXPECTED = {
    "lag": "seconds, at least 0 and finite",
    "horizon": "seconds above 0",
    "capacity": "at least 1 event",
    "clock": "'s' or 'ns'",
}


def _floats(leaf: Any) -> Any:
    return numbers("the control", leaf, np.shape(leaf))


_backward = eqx.filter_jit(backward)
