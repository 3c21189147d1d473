"""Online estimation: the same step over events that wait, behind a small stateful object."""

import dataclasses
import math
import threading
from collections.abc import Iterable
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError, DataError
from kedge.estimation.admission import (
    NONE,
    NS,
    Admission,
    Admitted,
    nanoseconds,
    numbers,
)
from kedge.estimation.answer import Answer, Event
from kedge.estimation.clipping import beyond
from kedge.estimation.compiled import Engine
from kedge.estimation.delayed import Origin, Window
from kedge.estimation.live_steps import begin_live
from kedge.estimation.log import SECOND
from kedge.estimation.restart import Jump, jump, restarted
from kedge.estimation.rig import Rig, as_arrays, check_step
from kedge.estimation.rows import EventForm, words_of
from kedge.estimation.saved import Saved, Settings
from kedge.estimation.timeline import Timeline
from kedge.estimation.traced_step import steps_for
from kedge.estimation.transition import require_smoothable

DAY = 86_400 * SECOND
"""ns after its start beyond which the first event of an estimator is none of its clock."""


class Estimator(Saved):
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
        start: Any = None,
        control: Any = None,
        lag: float = 0.0,
        horizon: float = 600.0,
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
        self._engine: Engine = engine
        self._key, self.resets = key, 0
        self._settings = Settings(start, lag, horizon, capacity, clock)
        self._filter, self._rig = as_arrays((filter.bind_sensors(rig.names), rig))
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
        heard = dict.fromkeys(self._allowed, self._start)
        self._limits = rig.vehicle.control_limits()
        self.clipped: dict[str, int] = {}
        """How often a component of the control was beyond its limit; it acts as that."""
        self._still = jax.tree.map(_floats, rig.vehicle.nominal_control(0.0))
        self._form, self._memory = EventForm(rig, self._still), (round(lag * SECOND), capacity)
        state = begin_live(self._filter, self._rig, key)
        self._compile(state)
        held: Any = np.zeros_like(self._steps.rows["held"][0])
        if control is not None:
            held = self._admission.control(control)
            if held is None:
                raise DataError(f"the control: found {control}, expected finite numbers")
        self._begin(state, self._start, held, heard)

    def _compile(self, state: Any) -> None:
        """The steps of its filter, and what lets events into their rows."""
        steps = steps_for(self._filter, self._rig, self._form, state, self._key, self._engine)
        self._steps, self._first = steps, steps.row_words
        self._admission = Admission(self._rig, self._form, steps.rows, self._still, self._unit)

    def _begin(self, state: Any, time: int, held: Any, heard: dict[int, int]) -> None:
        """A window without events behind a state."""
        origin = Origin(time, self._steps.pack(state), held)
        window = Window(origin, *self._memory, self._form.content)
        first = self._steps.first_answer(state).view(np.int64)
        self._line = Timeline(self._steps, window, self._start, first, heard)
        self._state: tuple[Any, Any] = origin.words, state

    @property
    def belief(self) -> Any:
        """What the filter believes after the newest event."""
        if self._line.after is not self._state[0]:
            self._state = self._line.after, self._steps.unpack(self._line.after)
        return self._state[1].belief

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors of its rig."""
        return self._names

    @property
    def time(self) -> Any:
        """Time of the newest event, as its clock counts."""
        return self._on_clock(self._line.time)

    @property
    def degraded(self) -> tuple[str, ...]:
        """Sensors of which nothing was fused for longer than their ``allowed_silence``."""
        now = self._line.time
        return tuple(
            self._names[rank]
            for rank, allowed in self._allowed.items()
            if now - self._line.heard[rank] > allowed
        )

    def ready(self) -> None:
        """Compile all that can come; afterwards nothing compiles."""
        self._line.ready()

    def push(
        self,
        time: Any,
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
        event = self._admission.event(time, sensor, measurement, control, target, cov, sequence)
        return Answer(self._steps.form, self._one(event))

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
        if rows.dtype != self._form.dtype or rows.ndim != 1:
            raise DataError(
                f"push_many: found an array of {rows.dtype.name} numbers, expected rows as "
                "Estimator.rows makes them, or events"
            )
        words = words_of(np.ascontiguousarray(rows)).copy()
        admitted, line, first = self._admission.checked(words), self._line, self._first
        if not self._knows_start and admitted:
            self._check_clock(admitted[0][0][0])
        answers = np.zeros(len(rows), self._steps.form.dtype)
        written, place, gap = words_of(answers), 0, min(self._horizon, self._longest)
        while place < len(admitted):
            end = line.in_order(admitted, place, gap)
            if end <= place + 1:
                first[0] = words[place]
                written[place] = self._one(admitted[place])
                place += 1
                continue
            first[: end - place] = words[place:end]
            written[place:end] = line.append(admitted[place:end])
            if self._limits is not None:
                for _, control, _ in admitted[place:end]:
                    self._clip(control)
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
            (time, *_), _, fate = self._admission.event(*event)
            row = self._steps.rows[:1].copy()
            row["time"], row["has_control"] = time, fate != NONE
            written.append(row)
        return np.concatenate(written) if written else self._form.blank(0)

    def answers(self, rows: np.ndarray) -> list[Answer]:
        """Objects of what :meth:`push_many` returned."""
        return [Answer(self._steps.form, words) for words in words_of(rows)]

    def peek(self, time: Any) -> Gaussian:
        """What it will believe at ``time`` if nothing comes until then; nothing changes.

        Raises:
            DataError: the time is not finite, or before that of the newest event.
            ContractError: another thread pushes.
        """
        return self._foreseen(nanoseconds(time, self._unit), "peek")

    def reset(self, mean: Any, cov: Any = None, time: Any = None) -> Jump:
        """Believe something else from now, or from ``time``, on; the jump that this was.

        ``mean`` is a state or values by field, as an operator gives a pose: ``{"position":
        [2.0, 1.0], "heading": 0.3}``; ``cov`` a covariance, or standard deviations by field.
        What they do not name stays as it was. What is older than the reset is LATE from then
        on; controls, counters and what was heard of sensors stay. :attr:`resets` counts them.

        Raises:
            DataError: a value is of no use, or the time is before that of the newest event.
            ContractError: another thread pushes.
        """
        now = self._line.time if time is None else nanoseconds(time, self._unit)
        before = self._foreseen(now, "reset")
        after = restarted(before, mean, cov)
        self._restart(after, now)
        self.resets += 1
        return jump(self._on_clock(now), before, after)

    def swap(self, filter: AbstractFilter) -> None:
        """Go on with another filter, from mean and covariance of this one.

        It compiles the new one's steps: prepare for that with one that is not driving. What is
        older than the swap is LATE from then on.

        Raises:
            ContractError: the filter cannot run this rig; the old one goes on.
        """
        kept = self._filter, self._steps, self._first, self._admission
        moments = self._foreseen(self._line.time, "swap")
        try:
            self._filter = as_arrays(filter.bind_sensors(self._names))
            rig = dataclasses.replace(self._rig, prior=moments)
            self._compile(begin_live(self._filter, rig, self._key))
            self._restart(moments, self._line.time)
        except BaseException:
            self._filter, self._steps, self._first, self._admission = kept
            raise

    def _foreseen(self, at: int, what: str) -> Gaussian:
        """What it will believe at that ns if nothing comes until then."""
        self._belongs_here()
        if at < self._line.time:
            unit = _CLOCKS[self._unit]
            raise DataError(
                f"{what} at {self._on_clock(at):.10g} {unit}: the newest event is at "
                f"{self.time:.10g} {unit} already"
            )
        return Answer(self._steps.form, self._line.peek(at)).moments

    def _restart(self, belief: Gaussian, time: int) -> None:
        rig = as_arrays(dataclasses.replace(self._rig, prior=belief))
        key = jax.random.fold_in(self._key, self.resets + 1)
        state = begin_live(self._filter, rig, key, (time - self._start) / SECOND)
        self._begin(state, time, self._line.held, self._line.heard)

    def smoothed(self) -> list[tuple[Any, Gaussian]]:
        """The estimates of the window in the light of all its readings: a fixed-lag smoother.

        The first is the most certain about the past: everything of the ``lag`` seconds after
        it has been used.

        Raises:
            ContractError: the filter carries neither a Gaussian nor an ensemble.

        Source: S. Särkkä, "Bayesian Filtering and Smoothing", 2013, sections 8.2 and 10.6.
        """
        require_smoothable(self._filter)
        return [(self._on_clock(time), moments) for time, moments in self._line.smoothed()]

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

    def _check_clock(self, time: int) -> None:
        """Refuse a first event that is of another clock than the start.

        Raises:
            DataError: it is more than a day away.
        """
        if abs(time - self._start) > DAY:
            raise DataError(
                f"the first event is at {self._on_clock(time):.10g} {_CLOCKS[self._unit]}, but "
                f"the estimator starts at 0 {_CLOCKS[self._unit]}: give the time of its prior, "
                "as start="
            )
        self._knows_start = True

    def _one(self, event: Admitted) -> np.ndarray:
        """The event in the first row; the words of its answer."""
        order, control, _ = event
        if not self._knows_start:
            self._check_clock(order[0])
        passed = order[0] - self._line.time
        if self._longest < passed <= self._horizon:
            what = f"event at {self._on_clock(order[0]):g} s: the step since the event before"
            check_step(self._vehicle, passed / SECOND, what)
        words, done = self._line.one(event, self._horizon)
        if control is not None and self._limits is not None and done:
            self._clip(control)
        return words

    def _clip(self, control: np.ndarray | None) -> None:
        if control is not None:
            for label in beyond(self._form.control(control), self._limits):
                self.clipped[label] = self.clipped.get(label, 0) + 1

    def _on_clock(self, time: int) -> Any:
        """A time as the clock counts."""
        return time if self._unit == NS else time / SECOND


_CLOCKS = {1.0: "s", NS: "ns"}
_EXPECTED = {
    "lag": "seconds, at least 0 and finite",
    "horizon": "seconds above 0",
    "capacity": "at least 1 event",
    "clock": "'s' or 'ns'",
}


def _floats(leaf: Any) -> Any:
    return numbers("the control", leaf, np.shape(leaf))
