"""Offline estimation: scan a filter over a log."""

from collections.abc import Callable
from typing import Any, TypeVar, overload

import equinox as eqx
import jax
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractFilter
from kedge.estimation.compiled import Engine, compiled_pass
from kedge.estimation.log import Log, Recording, events_of
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.traced import Estimates as Estimates
from kedge.estimation.traced import pass_over as pass_over
from kedge.estimation.transition import require_smoothable

T = TypeVar("T")


@overload
def estimate(
    filter: AbstractFilter,
    rig: Rig,
    log: Log | Recording,
    key: PRNGKeyArray | None = None,
    keep: None = None,
    engine: Engine = "auto",
) -> Estimates: ...
@overload
def estimate(
    filter: AbstractFilter,
    rig: Rig,
    log: Log | Recording,
    key: PRNGKeyArray | None = None,
    *,
    keep: Callable[[Estimates], T],
    engine: Engine = "auto",
) -> T: ...
def estimate(
    filter: AbstractFilter,
    rig: Rig,
    log: Log | Recording,
    key: PRNGKeyArray | None = None,
    keep: Callable[[Estimates], Any] | None = None,
    engine: Engine = "auto",
) -> Any:
    """Run ``filter`` over every event of ``log``; return its :class:`Estimates`.

    ``key`` feeds the filters that draw random numbers; without one it is ``jax.random.key(0)``.
    ``keep`` picks inside the compiled program what is returned of the estimates, and nothing
    else is stored: the covariances of a thousand states at every event would not fit.
    ``engine`` is explained at :data:`kedge.estimation.compiled.Engine`.

    It is a pure function of arrays, so JAX's transformations go through it: ``jax.grad`` of
    ``estimate(...).log_likelihood`` by parameters of the vehicle, the sensors, the prior or the
    readings; ``jax.vmap`` over priors, parameters or keys; ``jax.jit`` around a program that
    it is a part of. Within them XLA is the engine. Reverse mode keeps what the scan needs of
    each event; with few parameters ``jax.jacfwd`` is quicker.

    Raises:
        ContractError: the engine asked for cannot run this.
    """
    filter, rig, events = as_arrays((filter, rig, events_of(log)))
    native = compiled_pass(filter, rig, events, False, engine, keep)
    if native is not None:
        return native.over(filter, rig, events)
    if keep is not None:
        return _kept(filter, rig, events, _key(key), keep)
    return scan(filter, rig, events, _key(key), False)[0]


def estimate_with_history(
    filter: AbstractFilter,
    rig: Rig,
    log: Log | Recording,
    key: PRNGKeyArray | None = None,
    engine: Engine = "auto",
) -> tuple[Estimates, Any]:
    """Like :func:`estimate`, and keep what a smoother needs.

    Raises:
        ContractError: the filter carries neither a Gaussian nor an ensemble, or the engine
            asked for cannot run this.
    """
    filter, rig, events = as_arrays((filter, rig, events_of(log)))
    require_smoothable(filter)
    native = compiled_pass(filter, rig, events, True, engine)
    if native is not None:
        return native.over(filter, rig, events)
    return scan(filter, rig, events, _key(key), True)


def compile_estimate(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    keep: bool,
    key: PRNGKeyArray | None = None,
    engine: Engine = "auto",
) -> Callable[[], tuple[Estimates, Any]]:
    """Compile without running, so that the time of a run can be told from that of compiling.

    The call returned gives the estimates and, with ``keep``, the history.

    Raises:
        ContractError: ``keep`` with a filter that cannot be smoothed, or the engine asked for
            cannot run this.
    """
    filter, rig, log = as_arrays((filter, rig, log))
    if keep:
        require_smoothable(filter)
    native = compiled_pass(filter, rig, log, keep, engine)
    if native is not None:
        call = native.bound(filter, rig, log)
        return call if keep else lambda: (call(), None)
    arguments = filter, rig, log, _key(key), keep
    compiled = scan.lower(*arguments).compile()
    return lambda: compiled(*arguments)


def _key(key: PRNGKeyArray | None) -> PRNGKeyArray:
    return jax.random.key(0) if key is None else key


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
