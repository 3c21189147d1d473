"""Online estimation: the same step, one event at a time, behind a small stateful object."""

import math
import threading
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError, DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.admission import Admission, is_finite, numbers, seconds
from kedge.estimation.clipping import beyond
from kedge.estimation.compiled import Engine
from kedge.estimation.delayed import Entry, Event, State, Window
from kedge.estimation.log import Log
from kedge.estimation.native_step import NativeStep
from kedge.estimation.rig import Rig, as_arrays, check_step
from kedge.estimation.smoother import backward
from kedge.estimation.step import (
    Outcome,
    begin,
    predict_to,
    process_measurement,
    silence,
    widest,
)
from kedge.estimation.transition import is_smoothable, require_smoothable

DAY = 86_400.0
"""s after its start beyond which the first event of an estimator is none of its clock."""


class Answer(NamedTuple):
    """What an event led to."""

    moments: Gaussian
    """The estimate after the newest event, in the light of this one."""
    outcome: Outcome
    replayed: int = 0
    """How many events were done again, since this one came late."""
    control: Verdict = Verdict.NONE
    """What became of the control: FUSED if it holds from now on."""

    @property
    def verdict(self) -> Verdict:
        """What became of the reading, or why the whole event changed nothing."""
        return Verdict(int(self.outcome.verdict))


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

    Times are seconds of any clock; ``start`` is the prior's, 0 unless it is given. An estimator
    belongs to the thread of its first event.

    Raises:
        DataError: a setting or the first control is of no use.
        ContractError: the control is that of another vehicle.
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
    ):
        for name, value, good in (
            ("lag", lag, 0 <= lag < math.inf),
            ("horizon", horizon, horizon > 0),
            ("capacity", capacity, capacity >= 1),
        ):
            if not good:
                raise DataError(f"estimator: {name} is {value}, expected {_EXPECTED[name]}")
        self._key = jax.random.key(0) if key is None else key
        self._filter, self._rig = as_arrays((filter.bind_sensors(rig.names), rig))
        self._width = widest(rig.sensors)
        # An attribute of a module costs as much as an event.
        self._names = rig.names
        self._ranks = {name: rank for rank, name in enumerate(self._names)}
        self._horizon, self._start = horizon, 0.0 if start is None else seconds(start)
        self._knows_start, self._thread = start is not None, 0
        self._vehicle, self._longest = rig.vehicle, rig.vehicle.longest_step()
        # By rank: the silence that is allowed, and when the sensor was last heard.
        silences = {rank: one.allowed_silence for rank, one in enumerate(rig.sensors)}
        self._allowed = {rank: s for rank, s in silences.items() if s is not None}
        self._heard = dict.fromkeys(self._allowed, self._start)
        self._limits = rig.vehicle.control_limits()
        self.clipped: dict[str, int] = {}
        """How often a component of the control was told beyond its limit; it acts as that."""
        still = jax.tree.map(np.zeros_like, _floats(rig.vehicle.nominal_control(0.0)))
        self._admission = Admission(rig, still)
        held = still if control is None else self._admission.control(control)
        if not is_finite(held):
            raise DataError(f"the control: found {control}, expected finite numbers")
        state = _begin(self._filter, self._rig, self._key, self._start)
        self._native = NativeStep(
            self._filter, self._rig, held, lag > 0 and is_smoothable(self._filter), engine
        )
        self._window = Window(State(state, self._start, held), lag, capacity)
        self._silence: Outcome = jax.tree.map(np.asarray, silence(self._width))
        self._known: tuple[Any, Any] = None, None

    @property
    def belief(self) -> Any:
        """What the filter believes after the newest event."""
        return self._window.newest.filter.belief

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors of its rig."""
        return self._names

    @property
    def time(self) -> float:
        """Time of the newest event in s."""
        return self._window.newest.time

    @property
    def degraded(self) -> tuple[str, ...]:
        """Sensors of which nothing was fused for longer than their ``allowed_silence``."""
        return tuple(
            self._names[rank]
            for rank, allowed in self._allowed.items()
            if self.time - self._heard[rank] > allowed
        )

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
        """Advance to ``time`` in s, use a reading if one is given, then hold a new control.

        ``target`` is a row of the sensor's map, ``cov`` the covariance of this one reading.
        ``sequence`` orders readings of one sensor at one time that may arrive in any order.

        Raises:
            DataError: the time is not finite, or the first one is far from ``start``; something
                holds no numbers, or those of another shape.
            ContractError: the rig has no such sensor, a reading or control is of another
                class, or the step is longer than the vehicle's stays stable: tell it of times
                in between. Another thread has pushed before.
        """
        self._belongs_here()
        time = seconds(time)
        rank = len(self._ranks) if control is None else -1
        reading = None
        if sensor is not None:
            known = self._ranks.get(sensor)
            rank = self._rig.index(sensor) if known is None else known
            reading = self._admission.reading(rank, measurement, target, cov)
        held = None if control is None else self._admission.control(control)
        taken = Verdict.NONE if held is None else Verdict.FUSED
        if held is not None and not is_finite(held):
            held, taken = None, Verdict.NOT_FINITE
        event = Event(time, rank, sequence, reading, held)
        if not self._knows_start:
            self._check_clock(time)
        if time - self.time > self._horizon:
            return self._unchanged(Verdict.FUTURE, taken)
        if self._window.too_late(time):
            return self._unchanged(Verdict.LATE, taken)
        if self._window.holds(event):
            return self._unchanged(Verdict.DUPLICATE, taken)
        if time - self.time > self._longest:
            what = f"event at {time:g} s: the step since the event before"
            check_step(self._vehicle, time - self.time, what)
        answer = self._take(event, taken)
        if held is not None and self._limits is not None:
            for label in beyond(held, self._limits):
                self.clipped[label] = self.clipped.get(label, 0) + 1
        return answer

    def peek(self, time: float) -> Gaussian:
        """What it will believe at ``time`` if nothing comes until then; nothing changes.

        Raises:
            DataError: the time is not finite, or before that of the newest event.
            ContractError: another thread pushes.
        """
        self._belongs_here()
        time = seconds(time)
        if time < self.time:
            raise DataError(
                f"peek at {time:g} s: the newest event is at {self.time:g} s already"
            )
        entry = self._next(self._window.newest, Event(time, len(self._ranks), 0))
        if entry.moments is not None:
            return entry.moments
        return _moments(entry.after.filter.belief)

    def smoothed(self) -> list[tuple[float, Gaussian]]:
        """The estimates of the window in the light of all its readings: a fixed-lag smoother.

        The first is the most certain about the past: everything of the ``lag`` seconds after
        it has been used.

        Raises:
            ContractError: the filter carries neither a Gaussian nor an ensemble.

        Source: S. Särkkä, "Bayesian Filtering and Smoothing", 2013, sections 8.2 and 10.6.
        """
        require_smoothable(self._filter)
        beliefs: list[tuple[float, Gaussian]] = []
        later: Any = None
        for entry in reversed(self._window.entries):
            filtered = _moments(entry.after.filter.belief)
            if later is not None:
                filtered = _backward(filtered, beliefs[-1][1], later)
            beliefs.append((entry.event.time, filtered))
            later = entry.record
        return beliefs[::-1]

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

    def _check_clock(self, time: float) -> None:
        """Refuse a first event that is of another clock than the start.

        Raises:
            DataError: it is more than a day away.
        """
        if abs(time - self._start) > DAY:
            raise DataError(
                f"the first event is at {time:.10g} s, but the estimator starts at 0 s: give "
                "the time of its prior, as start="
            )
        self._knows_start = True

    def _take(self, event: Event, control: Verdict) -> Answer:
        place = self._window.place(event)
        state, entries = self._window.before(place), []
        for one in (event, *(entry.event for entry in self._window.entries[place:])):
            entries.append(self._next(state, one))
            state = entries[-1].after
        # Only now, so that an event that raises has changed nothing.
        self._window.replace(place, entries)
        self._hear(entries)
        return Answer(self._moments(), entries[0].outcome, len(entries) - 1, control)

    def _hear(self, entries: list[Entry]) -> None:
        """Remember when something was last fused of the sensors that must not fall silent."""
        for event, outcome in ((entry.event, entry.outcome) for entry in entries):
            heard = event.reading is not None and event.rank in self._allowed
            if heard and int(outcome.verdict) == Verdict.FUSED:
                self._heard[event.rank] = max(self._heard[event.rank], event.time)

    def _next(self, state: State, event: Event) -> Entry:
        """One event done, from the state before it."""
        done = self._native.take(state, event)
        if done is not None:
            after, moments, outcome, past = done
            return Entry(event, after, outcome, past, moments)
        time, dt = (jnp.asarray(x, float) for x in (event.time, event.time - state.time))
        # A smoother's share of the prediction costs little, but only a window keeps it.
        remember = self._window.lag > 0 and is_smoothable(self._filter)
        after, record = _predict_to(
            self._filter, self._rig.vehicle, state.filter, state.control, time, self._key,
            remember, dt,
        )  # fmt: skip
        outcome = silence(self._width)
        if event.reading is not None:
            after, outcome = _process_measurement(
                self._filter, self._rig.sensors, event.rank, after, event.reading, self._key
            )
        control = state.control if event.control is None else event.control
        return Entry(event, State(after, event.time, control), outcome, record)

    def _moments(self) -> Gaussian:
        """The newest estimate, computed once."""
        entries = self._window.entries
        if entries and entries[-1].moments is not None:
            return entries[-1].moments
        if (belief := self.belief) is not self._known[0]:
            self._known = belief, _moments(belief)
        return self._known[1]

    def _unchanged(self, verdict: Verdict, control: Verdict) -> Answer:
        # By NumPy alone: to refuse is not to cost more than to fuse.
        outcome = self._silence._replace(verdict=np.asarray(int(verdict)))
        refused = Verdict.NONE if control == Verdict.NONE else verdict
        return Answer(self._moments(), outcome, 0, refused)


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


_EXPECTED = {
    "lag": "seconds, at least 0 and finite",
    "horizon": "seconds above 0",
    "capacity": "at least 1 event",
}


def _floats(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: numbers("the control", leaf, np.shape(leaf)), tree)


# Compiled, because an operation that is not costs as much as an event.
_begin = eqx.filter_jit(lambda filter, rig, key, time: as_arrays(begin(filter, rig, key, time)))
_moments = eqx.filter_jit(lambda belief: belief.moments())
_predict_to = eqx.filter_jit(predict_to)
_process_measurement = eqx.filter_jit(process_measurement)
_backward = eqx.filter_jit(backward)
