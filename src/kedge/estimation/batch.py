"""Offline estimation: scan a filter over a log."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter, AbstractGaussianFilter
from kedge.core.errors import ContractError
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.step import Outcome, advance, condition, event_keys


class Estimates(NamedTuple):
    """What a filter believed after each event, and what became of each reading."""

    time: Float[Array, "*T"]
    moments: Gaussian
    outcome: Outcome


class History(NamedTuple):
    """What smoothing needs of each event's prediction."""

    predicted: Gaussian
    cross: Float[Array, "T n n"]
    """Covariance of the state after the event before with the state predicted here."""


def estimate(
    filter: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray | None = None
) -> Estimates:
    """Run ``filter`` over every event of ``log``; return its moments after each.

    ``key`` feeds the filters that draw random numbers; without one it is ``jax.random.key(0)``.
    """
    filter, rig, log = as_arrays((filter, rig, log))
    return scan(filter, rig, log, _key(key), False)[0]


def estimate_with_history(
    filter: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray | None = None
) -> tuple[Estimates, History]:
    """Like :func:`estimate`, and keep what a smoother needs.

    Raises:
        ContractError: the filter does not carry a Gaussian.
    """
    filter, rig, log = as_arrays((filter, rig, log))
    require_gaussian(filter)
    return scan(filter, rig, log, _key(key), True)


def compile_estimate(
    filter: AbstractFilter, rig: Rig, log: Log, keep: bool, key: PRNGKeyArray | None = None
) -> Callable[[], tuple[Estimates, Any]]:
    """Compile without running, so that the time of a run can be told from that of compiling.

    The call returned gives the estimates and, with ``keep``, the history.

    Raises:
        ContractError: ``keep`` with a filter that does not carry a Gaussian.
    """
    arguments = (*as_arrays((filter, rig, log)), _key(key), keep)
    if keep:
        require_gaussian(filter)
    compiled = scan.lower(*arguments).compile()
    return lambda: compiled(*arguments)


def require_gaussian(filter: AbstractFilter) -> None:
    """Refuse to smooth what has no Gaussian.

    Raises:
        ContractError: the filter does not carry a Gaussian.
    """
    if not isinstance(filter, AbstractGaussianFilter):
        raise ContractError(
            f"{type(filter).__name__} cannot be smoothed: it carries no Gaussian; "
            "use a Gaussian filter such as 'extended' or 'unscented'"
        )


def _key(key: PRNGKeyArray | None) -> PRNGKeyArray:
    return jax.random.key(0) if key is None else key


def pass_over(
    filter: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray, keep: bool
) -> tuple[Estimates, Any]:
    """The pass behind the functions above, for callers that batch or compile it themselves.

    Parameters must be arrays already; with ``keep`` the second result is a :class:`History`.
    """

    def predict(belief, control, dt, key):
        if not (keep and isinstance(filter, AbstractGaussianFilter)):
            return advance(filter, rig.vehicle, belief, control, dt, key), None
        belief, cross = lax.cond(
            dt > 0,
            lambda gaussian=filter: gaussian.transition(rig.vehicle, belief, control, dt),
            lambda: (belief, belief.cov),
        )
        return belief, History(belief, cross)

    def body(carry: tuple[Any, Any, Any], event: Any) -> tuple[Any, Any]:
        belief, last, count = carry
        (time, sensor, row), control = event
        # Older than the belief: nothing happens, and the event does not count (as online).
        late = time < last
        count = count + jnp.where(late, 0, 1)
        predict_key, update_key = event_keys(key, count)
        belief, history = predict(belief, control, time - last, predict_key)
        belief, outcome = condition(
            filter,
            rig.sensors,
            belief,
            log.readings,
            jnp.where(late, -1, sensor),
            row,
            update_key,
        )
        verdict = jnp.where(late & (sensor >= 0), Verdict.LATE, outcome.verdict)
        outcome = outcome._replace(verdict=verdict)
        return (belief, jnp.maximum(time, last), count), (belief.moments(), outcome, history)

    belief = filter.init(rig.prior, event_keys(key, 0)[0])
    start = belief, jnp.zeros(()), jnp.zeros((), int)
    events = log.schedule, log.controls
    _, (moments, outcome, history) = lax.scan(body, start, events)
    return Estimates(log.schedule.time, moments, outcome), history


scan: Any = eqx.filter_jit(pass_over)
