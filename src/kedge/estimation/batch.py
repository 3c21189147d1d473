"""Offline estimation: scan a filter over a log."""

from collections.abc import Callable
from typing import Any, TypeVar, overload

from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractFilter
from kedge.estimation.best_start import best_start
from kedge.estimation.compiled import Engine
from kedge.estimation.log import Log, Recording, events_of
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.runner import Runner
from kedge.estimation.traced import Estimates as Estimates
from kedge.estimation.traced import pass_over as pass_over
from kedge.estimation.transition import require_smoothable
from kedge.filters.wrappers.hypotheses import Hypotheses

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
    given = as_arrays((filter, rig, events_of(log)))
    return Runner(given, key, keep, engine=engine).over(given)[0]


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
    require_smoothable(filter)
    given = as_arrays((filter, rig, events_of(log)))
    return Runner(given, key, history=True, engine=engine).over(given)


def compile_estimate(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    keep: bool,
    key: PRNGKeyArray | None = None,
    engine: Engine = "auto",
) -> Callable[[], tuple[Estimates, Any]]:
    """Compile without running, so that the time of a run can be told from that of compiling.

    The call returned gives the estimates and, with ``keep``, the history. With it a bank of
    hypotheses gives the pass of its inner filter from the start that foresaw the log best.

    Raises:
        ContractError: ``keep`` with a filter that cannot be smoothed, or the engine asked for
            cannot run this.
    """
    if keep and isinstance(filter, Hypotheses):
        filter, rig = best_start(filter, rig, log, key, engine)
    if keep:
        require_smoothable(filter)
    given = as_arrays((filter, rig, log))
    runner = Runner(given, key, history=keep, engine=engine)
    runner.compile(given)
    return runner.bound(given)
