"""Online estimation: the same step, one event at a time, behind a small stateful object."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Readings
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.step import Outcome, advance, event_keys, silence, take_in, widest


class Answer(NamedTuple):
    """What an event led to."""

    moments: Gaussian
    outcome: Outcome

    @property
    def verdict(self) -> Verdict:
        """What became of the reading."""
        return Verdict(int(self.outcome.verdict))


class Estimator:
    """Feed events as they come; read the belief at any moment.

    A control holds from its time on; until the first, ``control`` does, or nothing. An event
    older than the belief changes nothing and gets the verdict LATE; a belief never goes back.
    """

    def __init__(
        self,
        filter: AbstractFilter,
        rig: Rig,
        key: PRNGKeyArray | None = None,
        start: float = 0.0,
        control: Any = None,
    ):
        self._key = jax.random.key(0) if key is None else key
        self._filter, self._rig = as_arrays((filter, rig))
        still = jax.tree.map(jnp.zeros_like, as_arrays(rig.vehicle.drive(0.0)))
        self._control = still if control is None else _floats(control)
        self._events = 0
        self.belief = _init(self._filter, self._rig.prior, _keys(self._key, 0)[0])
        self.time = float(start)

    def push(
        self,
        time: float,
        sensor: str | None = None,
        measurement: Any = None,
        *,
        control: Any = None,
        target: int | Int[Array, ""] = 0,
        cov: Any = None,
    ) -> Answer:
        """Advance to ``time`` in s, use a reading if one is given, then hold a new control.

        Raises:
            DataError: the time is not finite.
            ContractError: the rig has no such sensor.
        """
        if not jnp.isfinite(time):
            raise DataError(f"event time is {time}; expected seconds since the start")
        width = widest(self._rig.sensors)
        if time < self.time:
            late = silence(width)._replace(verdict=jnp.asarray(Verdict.LATE))
            return Answer(_moments(self.belief), late)
        count = self._events + 1
        predict_key, update_key = _keys(self._key, count)
        dt = jnp.asarray(time - self.time, float)
        belief, outcome = (
            _advance(
                self._filter, self._rig.vehicle, self.belief, self._control, dt, predict_key
            ),
            silence(width),
        )
        if sensor is not None:
            installation = self._rig.sensors[self._rig.index(sensor)]
            seen, spread = _floats((measurement, cov))
            reading = Readings(seen, jnp.asarray(target), spread)
            belief, outcome = _take_in(
                self._filter, installation, belief, reading, update_key, width
            )
        # Only now, so that an event that raises has changed nothing.
        if control is not None:
            self._control = _floats(control)
        self.belief, self.time, self._events = belief, float(time), count
        return Answer(_moments(belief), outcome)


def _floats(tree: Any) -> Any:
    """Arrays of one type, whatever type of number a driver has at hand."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


# Compiled, because an operation that is not costs as much as an event.
_keys = jax.jit(event_keys)
_init = eqx.filter_jit(lambda filter, prior, key: as_arrays(filter.init(prior, key)))
_moments = eqx.filter_jit(lambda belief: belief.moments())
_advance = eqx.filter_jit(advance)
_take_in = eqx.filter_jit(take_in)
