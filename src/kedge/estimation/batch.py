"""Offline estimation: scan a filter over a log."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Log
from kedge.estimation.passage import is_smoothable, passage, require_smoothable
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.step import (
    Outcome,
    Standing,
    advance,
    begin,
    condition,
    event_keys,
)


class Estimates(NamedTuple):
    """What a filter believed after each event, and what became of each reading."""

    time: Float[Array, "*T"]
    moments: Gaussian
    outcome: Outcome


def estimate(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    key: PRNGKeyArray | None = None,
    keep: Callable[[Estimates], Any] | None = None,
) -> Any:
    """Run ``filter`` over every event of ``log``; return its :class:`Estimates`.

    ``key`` feeds the filters that draw random numbers; without one it is ``jax.random.key(0)``.
    ``keep`` picks inside the compiled program what is returned of the estimates, and nothing
    else is stored: the covariances of a thousand states at every event would not fit.
    """
    filter, rig, log = as_arrays((filter, rig, log))
    if keep is not None:
        return _kept(filter, rig, log, _key(key), keep)
    return scan(filter, rig, log, _key(key), False)[0]


def estimate_with_history(
    filter: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray | None = None
) -> tuple[Estimates, Any]:
    """Like :func:`estimate`, and keep what a smoother needs.

    Raises:
        ContractError: the filter carries neither a Gaussian nor an ensemble.
    """
    filter, rig, log = as_arrays((filter, rig, log))
    require_smoothable(filter)
    return scan(filter, rig, log, _key(key), True)


def compile_estimate(
    filter: AbstractFilter, rig: Rig, log: Log, keep: bool, key: PRNGKeyArray | None = None
) -> Callable[[], tuple[Estimates, Any]]:
    """Compile without running, so that the time of a run can be told from that of compiling.

    The call returned gives the estimates and, with ``keep``, the history.

    Raises:
        ContractError: ``keep`` with a filter that cannot be smoothed.
    """
    arguments = (*as_arrays((filter, rig, log)), _key(key), keep)
    if keep:
        require_smoothable(filter)
    compiled = scan.lower(*arguments).compile()
    return lambda: compiled(*arguments)


def _key(key: PRNGKeyArray | None) -> PRNGKeyArray:
    return jax.random.key(0) if key is None else key


def pass_over(
    filter: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray, keep: bool
) -> tuple[Estimates, Any]:
    """The pass behind the functions above, for callers that batch or compile it themselves.

    Parameters must be arrays already; with ``keep`` the second result is the history.
    """

    def predict(belief, control, dt, key):
        motion = filter, rig.vehicle, belief, control, dt, key
        if keep and is_smoothable(filter):
            return passage(*motion)
        return advance(*motion), None

    def body(carry: tuple[Standing, Any, Any, Any], event: Any) -> tuple[Any, Any]:
        standing, last, moves, takes = carry
        (time, sensor, row), control = event
        # Older than the belief: nothing happens, and the event does not count (as online).
        late = time < last
        moves = moves + jnp.where(time > last, 1, 0)
        takes = takes + jnp.where(late | (sensor < 0), 0, 1)
        predict_key, update_key = event_keys(key, moves, takes)
        belief, history = predict(standing.belief, control, time - last, predict_key)
        standing, outcome = condition(
            filter,
            rig.sensors,
            standing._replace(belief=belief),
            log.readings,
            jnp.where(late, -1, sensor),
            row,
            time,
            update_key,
        )
        verdict = jnp.where(late & (sensor >= 0), Verdict.LATE, outcome.verdict)
        outcome = outcome._replace(verdict=verdict)
        carry = standing, jnp.maximum(time, last), moves, takes
        return carry, (standing.belief.moments(), outcome, history)

    filter = filter.aboard(rig.names)
    none = jnp.zeros((), int)
    start = begin(filter, rig, key), jnp.zeros(()), none, none
    events = log.schedule, log.controls
    _, (moments, outcome, history) = lax.scan(body, start, events)
    return Estimates(log.schedule.time, moments, outcome), history


@eqx.filter_jit
def _kept(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    key: PRNGKeyArray,
    keep: Callable[[Estimates], Any],
) -> Any:
    return keep(pass_over(filter, rig, log, key, False)[0])


scan: Any = eqx.filter_jit(pass_over)
