"""Online estimation: the same step, one event at a time, behind a small stateful object."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.clipping import beyond
from kedge.estimation.compiled import Engine
from kedge.estimation.delayed import Entry, Event, State, Window
from kedge.estimation.log import Log, Readings
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

FLOAT = jax.dtypes.canonicalize_dtype(float)


class Answer(NamedTuple):
    """What an event led to."""

    moments: Gaussian
    """The estimate after the newest event, in the light of this one."""
    outcome: Outcome
    replayed: int = 0
    """How many events were done again, since this one came late."""

    @property
    def verdict(self) -> Verdict:
        """What became of the reading."""
        return Verdict(int(self.outcome.verdict))


class Estimator:
    """Feed events as they come; read the belief at any moment.

    A control holds from its time on; until the first, ``control`` does, or nothing.

    A sensor of which nothing is fused for longer than its ``allowed_silence`` makes the
    estimate ``degraded``; it goes on by what the others and the vehicle's motion tell.

    Events of the last ``lag`` seconds may come in any order: the estimator goes back to where
    a late one belongs and does again what follows, so the belief is that of the run in which
    all came in time. What is older changes nothing and gets the verdict LATE. A message that
    comes twice gets DUPLICATE; one stamped more than ``horizon`` seconds ahead gets FUTURE,
    since it would make everything after it late. At most ``capacity`` events are remembered.
    """

    def __init__(
        self,
        filter: AbstractFilter,
        rig: Rig,
        key: PRNGKeyArray | None = None,
        start: float = 0.0,
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
        self._horizon, self._start = horizon, float(start)
        self._vehicle, self._longest = rig.vehicle, rig.vehicle.longest_step()
        # By rank: the silence that is allowed, and when the sensor was last heard.
        silences = {rank: one.allowed_silence for rank, one in enumerate(rig.sensors)}
        self._allowed = {rank: s for rank, s in silences.items() if s is not None}
        self._heard = dict.fromkeys(self._allowed, self._start)
        self._limits = rig.vehicle.control_limits()
        self.clipped: dict[str, int] = {}
        """How often a component of the control was told beyond its limit; it acts as that."""
        still = jax.tree.map(np.zeros_like, _floats(rig.vehicle.nominal_control(0.0)))
        held = still if control is None else _floats(control)
        state = _begin(self._filter, self._rig, self._key, self._start)
        self._native = NativeStep(
            self._filter, self._rig, held, lag > 0 and is_smoothable(self._filter), engine
        )
        self._window = Window(State(state, self._start, held), lag, capacity)

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
        target: int | Int[Array, ""] = 0,
        cov: Any = None,
        sequence: int = 0,
    ) -> Answer:
        """Advance to ``time`` in s, use a reading if one is given, then hold a new control.

        ``sequence`` orders readings of one sensor at one time that may arrive in any order.

        Raises:
            DataError: the time is not finite.
            ContractError: the rig has no such sensor, or the step is longer than the vehicle's
                stays stable: tell it of times in between.
        """
        if not math.isfinite(time):
            raise DataError(f"event time is {time}; expected seconds since the start")
        rank = len(self._ranks) if control is None else -1
        reading = None
        if sensor is not None:
            known = self._ranks.get(sensor)
            rank = self._rig.index(sensor) if known is None else known
            which: Any = np.asarray(target)
            spread = None if cov is None else _floats(cov)
            reading = Readings(_floats(measurement), which, spread)
        held = None if control is None else _floats(control)
        event = Event(float(time), rank, sequence, reading, held)
        if time - self.time > self._horizon:
            return self._unchanged(event, Verdict.FUTURE)
        if self._window.too_late(time):
            return self._unchanged(event, Verdict.LATE)
        if self._window.holds(event):
            return self._unchanged(event, Verdict.DUPLICATE)
        if time - self.time > self._longest:
            what = f"event at {time:g} s: the step since the event before"
            check_step(self._vehicle, time - self.time, what)
        answer = self._take(event)
        if held is not None and self._limits is not None:
            for label in beyond(held, self._limits):
                self.clipped[label] = self.clipped.get(label, 0) + 1
        return answer

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

    def _take(self, event: Event) -> Answer:
        place = self._window.place(event)
        state, entries = self._window.before(place), []
        for one in (event, *(entry.event for entry in self._window.entries[place:])):
            entries.append(self._next(state, one))
            state = entries[-1].after
        # Only now, so that an event that raises has changed nothing.
        self._window.replace(place, entries)
        self._hear(entries)
        newest = self._window.entries[-1].moments
        moments = _moments(self.belief) if newest is None else newest
        return Answer(moments, entries[0].outcome, len(entries) - 1)

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

    def _unchanged(self, event: Event, verdict: Verdict) -> Answer:
        recorded = verdict if event.reading is not None else Verdict.NONE
        outcome = silence(self._width)._replace(verdict=jnp.asarray(recorded))
        return Answer(_moments(self.belief), outcome)


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
    """Arrays of one type, whatever type of number a driver has at hand."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, FLOAT), tree)


# Compiled, because an operation that is not costs as much as an event.
_begin = eqx.filter_jit(lambda filter, rig, key, time: as_arrays(begin(filter, rig, key, time)))
_moments = eqx.filter_jit(lambda belief: belief.moments())
_predict_to = eqx.filter_jit(predict_to)
_process_measurement = eqx.filter_jit(process_measurement)
_backward = eqx.filter_jit(backward)
