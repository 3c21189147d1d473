"""Faults: what goes wrong with readings, or with what filters are told of the control.

A fault is data: which sensor, which kind, when. Its draws come from its name, so that another
fault, or the same with other numbers, changes no other draw of a run.
"""

import abc
import functools
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from kedge.core.manifolds import Space, space
from kedge.core.quantities import Scalar, Seconds
from kedge.core.registry import unknown

CONTROL = "control"
"""The name that stands for what filters are told of the control."""


class When(NamedTuple):
    """The readings of a sensor, and whether a fault is there."""

    time: Float[Array, " n"]  # s
    active: Bool[Array, " n"]
    since: Float[Array, " n"]  # s; how long it has been there


class Episodes(eqx.Module):
    """A Poisson process of stretches that last exponentially; a new one ends the one before."""

    rate: Scalar = 0.1  # 1/s
    duration: Seconds = 1.0  # in the mean

    def draw(
        self, key: PRNGKeyArray, time: Float[Array, " n"]
    ) -> tuple[Bool[Array, " n"], Float[Array, " n"]]:
        """Whether an episode is there at each time, and since when; none is at time 0."""
        age_key, length_key = jr.split(key)
        span = jnp.diff(time, prepend=0.0)
        # Looking back, the latest beginning lies an exponential time ago: exact for any span.
        age = jr.exponential(age_key, time.shape) / self.rate
        length = self.duration * jr.exponential(length_key, time.shape)
        number = jnp.arange(len(time))
        latest = lax.cummax(jnp.where(age < span, number, -1))
        row = jnp.maximum(latest, 0)
        since = jnp.where(latest >= 0, time - (time - age)[row], jnp.inf)
        return since < length[row], since


class AbstractFault(eqx.Module):
    """One kind of fault."""


class AbstractReadingFault(AbstractFault):
    """What changes each reading by itself; ``component`` is one of its fields or components."""

    component: eqx.AbstractVar[str]

    @abc.abstractmethod
    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Any:
        """All that is needed to change each reading; leading axis n."""

    @abc.abstractmethod
    def change(
        self, chosen: np.ndarray, reading: Any, drawn: Any, std: Float[Array, " m"]
    ) -> Any:
        """One reading with the fault, in its chosen components."""


class AbstractTimeFault(AbstractFault):
    """What makes a reading tell of another time than that of its stamp.

    Stamps stay as they are, since all runs of a study share them: what is read changes.
    """

    @abc.abstractmethod
    def lag(self, key: PRNGKeyArray, when: When) -> Float[Array, " n"]:
        """How long before its stamp each reading was taken, in s."""


class AbstractHoldingFault(AbstractFault):
    """What puts an earlier reading in the place of one."""

    @abc.abstractmethod
    def source(self, when: When) -> Int[Array, " n"]:
        """The number of the reading that stands in the place of each."""


class AbstractDeliveryFault(AbstractFault):
    """What happens on the way: nothing to what is read, or to its stamp.

    A log is sorted by its stamps, so this concerns who hears messages as they come:
    :func:`kedge.simulation.delivery.delivered`.
    """

    @abc.abstractmethod
    def delays(self, key: PRNGKeyArray, when: When) -> Float[Array, "n 2"]:
        """How long each message is on its way, and its copy; infinite where there is none."""


class Fault(eqx.Module):
    """A kind of fault on a sensor, and when: in its windows (s), in its episodes, or always.

    It concerns readings of the targets with the numbers ``targets``, of all if there are none.
    """

    name: str = eqx.field(static=True)
    on: str = eqx.field(static=True)
    """The name of a sensor, or "control"."""
    kind: AbstractFault
    windows: tuple[tuple[float, float], ...] = eqx.field(static=True, default=())
    episodes: Episodes | None = None
    targets: tuple[int, ...] = eqx.field(static=True, default=())

    def when(
        self,
        key: PRNGKeyArray,
        time: Float[np.ndarray, " n"],
        target: Int[np.ndarray, " n"] | int = 0,
    ) -> When:
        """At which of the times, each with a reading of one target, it is there."""
        active, since = np.ones(len(time), bool), time
        if self.windows:
            begin, end = np.array(self.windows).T
            inside = (time[:, None] >= begin[None]) & (time[:, None] < end[None])
            active = inside.any(axis=1)
            since = np.min(np.where(inside, time[:, None] - begin[None], np.inf), axis=1)
        if self.targets:
            active = active & np.isin(target, self.targets)
        when = When(jnp.asarray(time), jnp.asarray(active), jnp.asarray(since))
        if self.episodes is None:
            return when
        inside, began = self.episodes.draw(key, when.time)
        return when._replace(active=when.active & inside, since=jnp.minimum(when.since, began))


class DrawnFault(NamedTuple):
    """A fault, drawn for all readings of its sensor."""

    kind: AbstractFault
    drawn: Any


def drawn(
    faults: Sequence[Fault],
    on: str,
    time: Float[np.ndarray, " n"],
    target: Int[np.ndarray, " n"],
    size: int,
    key: PRNGKeyArray | None,
) -> tuple[DrawnFault, ...]:
    """The faults of one sensor with ``size`` components, at the times of its readings."""
    results = []
    for fault in faults:
        if fault.on != on or key is None:
            continue
        when_key, draw_key = jr.split(jr.fold_in(key, zlib.crc32(fault.name.encode())))
        when, kind = fault.when(when_key, time, target), fault.kind
        if isinstance(kind, AbstractReadingFault):
            results.append(DrawnFault(kind, kind.draw(draw_key, when, size)))
        elif isinstance(kind, AbstractTimeFault):
            results.append(DrawnFault(kind, kind.lag(draw_key, when)))
        elif isinstance(kind, AbstractHoldingFault):
            results.append(DrawnFault(kind, kind.source(when)))
        elif isinstance(kind, AbstractDeliveryFault):
            results.append(DrawnFault(kind, kind.delays(draw_key, when)))
    return tuple(results)


def lags(drawn_faults: Sequence[DrawnFault]) -> Float[Array, " n"] | None:
    """How long before its stamp each reading was taken; None if no fault concerns time."""
    late = [t.drawn for t in drawn_faults if isinstance(t.kind, AbstractTimeFault)]
    return functools.reduce(jnp.add, late) if late else None


def changed(
    drawn_faults: Sequence[DrawnFault],
    row: Int[Array, ""],
    reading: Any,
    std: Float[Array, " m"],
) -> Any:
    """One reading, number ``row``, after all faults that change it by itself."""
    for kind, drawn in drawn_faults:
        if isinstance(kind, AbstractReadingFault):
            mine = jax.tree.map(lambda leaf: leaf[row], drawn)
            reading = kind.change(chosen(space(reading), kind.component), reading, mine, std)
    return reading


def all_changed(
    drawn_faults: Sequence[DrawnFault],
    readings: Any,
    stds: Float[Array, "n m"],
    alone: Any = (),
) -> tuple[Any, Any]:
    """All readings of a sensor after its faults, in their order.

    What is ``alone`` (their targets) is held with them, and not changed otherwise.
    """
    rows = jnp.arange(len(stds))
    for drawn_fault in drawn_faults:
        if isinstance(drawn_fault.kind, AbstractHoldingFault):
            held = drawn_fault.drawn
            readings, alone = jax.tree.map(lambda leaf, i=held: leaf[i], (readings, alone))
        elif isinstance(drawn_fault.kind, AbstractReadingFault):

            def one(row: Any, reading: Any, std: Any, only: DrawnFault = drawn_fault) -> Any:
                return changed([only], row, reading, std)

            readings = jax.vmap(one)(rows, readings, stds)
    return readings, alone


def chosen(outputs: Space, component: str) -> np.ndarray:
    """Which components are meant by a label, by a field's name, or by "": all."""
    if component in outputs.slices():
        cut = outputs.slices()[component]
        return (np.arange(outputs.size) >= cut.start) & (np.arange(outputs.size) < cut.stop)
    return np.array([component in ("", label) for label in outputs.labels], bool)


def validation_error(fault: Fault, spaces: Mapping[str, Space]) -> str | None:
    """What is wrong with a fault where there are these sensors, as ``key: message``."""
    if fault.on not in spaces:
        return f"on: {unknown('sensor', fault.on, list(spaces))}"
    outputs = spaces[fault.on]
    if outputs.size == 0:
        return f"on: nothing is told of a {fault.on} here, so nothing can go wrong with it"
    if isinstance(fault.kind, AbstractDeliveryFault) and fault.on == CONTROL:
        return f"on: found {CONTROL!r}, expected a sensor: controls are not sent as messages"
    component = getattr(fault.kind, "component", "")
    known = dict.fromkeys([*outputs.slices(), *outputs.labels])
    if component and component not in known:
        return f"parameters.component: {unknown('component', component, list(known))}"
    for begin, end in fault.windows:
        if not begin < end:
            return f"windows: found {begin:g} to {end:g} s, expected the earlier first"
    return None
