"""Closed loops: what moves is steered, step by step, by what is believed of it."""

import abc
import functools
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError
from kedge.core.manifolds import space_of
from kedge.core.quantities import Scalar
from kedge.estimation.log import SECOND, Readings
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.step import FilterState, begin, predict_to, process_measurement
from kedge.numerics.linalg import square_root
from kedge.simulation.faults import DrawnFault, changed
from kedge.simulation.scenario import AbstractWorld, History, Scenario
from kedge.simulation.sensing import noise_std, sensed, targets_of


class AbstractGuidedWorld(AbstractWorld):
    """A world in which a guidance steers by what it believes: see ``Scenario.feedback``.

    A command is held for ``hold`` steps. Whatever the guidance hears, the draws of the world
    and of its sensors are the same.
    """

    guided: ClassVar[bool] = True

    @abc.abstractmethod
    def begin(self, scenario: Scenario, key: PRNGKeyArray) -> tuple[Any, Any]:
        """What moves, at time 0, and all that is drawn at random, by step."""

    @abc.abstractmethod
    def state(self, body: Any) -> Any:
        """The true state, with the fields that sensors read, of what moves."""

    @abc.abstractmethod
    def intended(self, scenario: Scenario, time: Scalar) -> Any:
        """The state that is meant at a time: what is believed without any feedback."""

    @abc.abstractmethod
    def guidance(self, scenario: Scenario) -> Callable[[Any, Scalar], Any]:
        """What turns a believed state and the time into a command."""

    @abc.abstractmethod
    def move(self, scenario: Scenario, body: Any, command: Any, draws: Any) -> Any:
        """What moves at the end of each held step, and what filters are told of them.

        Both have a leading axis of ``hold`` steps, as ``draws`` have.
        """

    def hold(self, scenario: Scenario) -> int:
        """Steps for which a command is held."""
        del scenario
        return 1

    def fix(self, installation: Installation, target: Int[Array, ""], reading: Any) -> dict:
        """Fields of the state that a reading tells by itself: those that it shares with it."""
        del installation, target
        return reading._asdict()

    def unfold(
        self, scenario: Scenario, key: PRNGKeyArray, sensing: tuple[Key[Array, " _"], ...]
    ) -> History:
        steps, hold = scenario.steps, self.hold(scenario)
        if steps % hold:
            raise ContractError(
                f"world: a command is held for {hold} steps, found {steps} steps, expected a "
                f"multiple; change the duration by {steps % hold * scenario.dt:g} s"
            )
        body, draws = self.begin(scenario, key)
        first = self.state(body)
        steer, listener = self.guidance(scenario), _listener(self, scenario, first)
        ends = np.round(np.arange(steps + 1) * scenario.dt * SECOND) / SECOND
        by_hold = (steps // hold, hold)
        draws = jax.tree.map(lambda leaf: leaf.reshape(*by_hold, *leaf.shape[1:]), draws)
        blocks = (ends[:-1].reshape(by_hold), ends[1:].reshape(by_hold), draws)
        heard = _Sensing.of(scenario, sensing if listener.hears else ())

        def block(carry: Any, inputs: Any) -> tuple[Any, Any]:
            body, memory = carry
            (begins, ends, draws), fires, rows = inputs
            believed = listener.believed(memory, self.state(body), begins[0])
            command = steer(believed, begins[0])
            bodies, told = self.move(scenario, body, command, draws)
            states = jax.vmap(self.state)(bodies)
            for step in range(hold):
                state, control, when, row = _at(step, (states, told, (begins, ends), rows))
                memory = listener.moved(memory, control, *when)
                for place in range(len(heard.fires)):
                    use = functools.partial(_listen, listener, heard, place)
                    arguments = memory, state, row[place], when[1]
                    memory = lax.cond(fires[step, place], use, _ignore, *arguments)
            return (_at(-1, bodies), memory), (states, told)

        carry = body, listener.memory()
        inputs = blocks, *heard.by_block(*by_hold)
        _, (path, controls) = lax.scan(block, carry, inputs)
        path, controls = jax.tree.map(
            lambda leaf: leaf.reshape(steps, *leaf.shape[2:]), (path, controls)
        )
        return History(path, controls, first)


class _Sensing(NamedTuple):
    """Which sensor fires at the end of which step, and with which key."""

    sensors: tuple[Installation, ...]
    fires: tuple[Bool[np.ndarray, " K"], ...]
    keys: tuple[Key[Array, " _"], ...]
    drawn_faults: tuple[tuple[DrawnFault, ...], ...]

    @classmethod
    def of(cls, scenario: Scenario, keys: tuple[Key[Array, " _"], ...]) -> "_Sensing":
        sensors = scenario.rig.sensors[: len(keys)]
        number = np.arange(1, scenario.steps + 1)
        fires = tuple(np.isin(number, scenario.ticks(s)) for s in sensors)
        return cls(sensors, fires, keys, tuple(map(scenario.drawn_faults, sensors)))

    def by_block(self, blocks: int, hold: int) -> tuple[np.ndarray, np.ndarray]:
        """Who fires, and the row of its reading; by block, step and sensor."""
        fires = np.array(self.fires, bool).reshape(-1, blocks * hold)
        rows = np.maximum(np.cumsum(fires, axis=1) - 1, 0)
        shape = blocks, hold, len(self.fires)
        return fires.T.reshape(shape), rows.T.reshape(shape)

    def reading(self, place: int, row: Int[Array, ""], state: Any) -> Readings:
        """What a sensor reads: the same as is recorded of it."""
        installation, keys = self.sensors[place], self.keys[place]
        target = targets_of(installation, len(keys))[row]
        reading = sensed(installation, state, target, keys[row])
        if drawn_faults := self.drawn_faults[place]:
            std = noise_std(installation, state, target)
            reading = changed(drawn_faults, row, reading, std)
        return Readings(reading, target)


class AbstractListener(eqx.Module):
    """What a guidance believes, and what it has to remember for that."""

    hears: ClassVar[bool] = True
    """Whether readings make a difference."""

    @abc.abstractmethod
    def memory(self) -> Any:
        """What is remembered at time 0."""

    @abc.abstractmethod
    def believed(self, memory: Any, truth: Any, time: Scalar) -> Any:
        """The state by which the guidance steers."""

    def moved(self, memory: Any, control: Any, before: Scalar, time: Scalar) -> Any:
        """Time has passed, under a control as told."""
        del control, before, time
        return memory

    def heard(self, memory: Any, place: int, reading: Readings, time: Scalar) -> Any:
        """The sensor at a place of the rig has read something."""
        del place, reading, time
        return memory


class _Told(AbstractListener):
    """All goes as intended, or the truth is known."""

    hears: ClassVar = False
    world: AbstractGuidedWorld
    scenario: Scenario

    def memory(self) -> Any:
        return ()

    def believed(self, memory: Any, truth: Any, time: Scalar) -> Any:
        if self.scenario.feedback == "truth":
            return truth
        return self.world.intended(self.scenario, time)


class _LastReadings(AbstractListener):
    """The guidance believes what each field was last read to be; of the rest, what is meant."""

    world: AbstractGuidedWorld
    scenario: Scenario
    first: Any

    def memory(self) -> dict[str, Array]:
        meant, fields = self.world.intended(self.scenario, 0.0), {}
        for installation in self.scenario.rig.sensors:
            target = jnp.zeros((), int)
            fields |= self._known(installation, target, installation.expect(self.first, target))
        return {name: jnp.asarray(getattr(meant, name), float) for name in fields}

    def believed(self, memory: dict[str, Array], truth: Any, time: Scalar) -> Any:
        return self.world.intended(self.scenario, time)._replace(**memory)

    def heard(self, memory: dict, place: int, reading: Readings, time: Scalar) -> dict:
        installation = self.scenario.rig.sensors[place]
        known = self._known(installation, reading.target, reading.measurement)
        # Of what is missing, it believes what it believed before.
        return memory | {
            name: jnp.where(jnp.isnan(value).any(), memory[name], value)
            for name, value in known.items()
        }

    def _known(self, installation: Installation, target: Any, reading: Any) -> dict:
        fixed = self.world.fix(installation, target, reading)
        return {name: value for name, value in fixed.items() if hasattr(self.first, name)}


class _Filtered(AbstractListener):
    """The guidance believes a filter, which hears every reading as it is sensed."""

    rig: Rig
    filter: AbstractFilter
    key: PRNGKeyArray

    def memory(self) -> FilterState:
        return begin(self.filter, self.rig, self.key)

    def believed(self, memory: FilterState, truth: Any, time: Scalar) -> Any:
        return memory.belief.moments().mean

    def moved(
        self, memory: FilterState, control: Any, before: Scalar, time: Scalar
    ) -> FilterState:
        return predict_to(
            self.filter, self.rig.vehicle, memory, control, time, self.key, dt=time - before
        )[0]

    def heard(
        self, memory: FilterState, place: int, reading: Readings, time: Scalar
    ) -> FilterState:
        sensors = self.rig.sensors
        return process_measurement(self.filter, sensors, place, memory, reading, self.key)[0]


def _at(step: int, tree: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[step], tree)


def _listen(
    listener: AbstractListener,
    heard: _Sensing,
    place: int,
    memory: Any,
    state: Any,
    row: Int[Array, ""],
    time: Scalar,
) -> Any:
    return listener.heard(memory, place, heard.reading(place, row, state), time)


def _ignore(memory: Any, *_: Any) -> Any:
    return memory


def _listener(world: AbstractGuidedWorld, scenario: Scenario, first: Any) -> AbstractListener:
    if scenario.feedback == "readings":
        return _LastReadings(world, scenario, first)
    if scenario.feedback != "filter":
        return _Told(world, scenario)
    loop_filter, rig = scenario.loop_filter, scenario.rig
    if loop_filter is None or loop_filter.key is None:
        raise ContractError(
            "scenario: its guidance hears a filter, but none is named; run it as a study, or "
            'name one: scenario.feedback = "extended"'
        )
    prior = rig.prior
    if loop_filter.error is not None:
        mean = start_near(prior, first, loop_filter.error)
        rig = eqx.tree_at(lambda r: r.prior, rig, Gaussian(mean, prior.cov))
    return _Filtered(rig, loop_filter.filter.bind_sensors(rig.names), loop_filter.key)


def start_near(prior: Gaussian, first: Any, white: Float[Array, " n"]) -> Any:
    """The true state at time 0, plus an error with the covariance of the prior."""
    cls = type(prior.mean)
    start = cls(*(getattr(first, field) for field in cls._fields))
    return space_of(cls).boxplus(start, square_root(prior.cov) @ white)
