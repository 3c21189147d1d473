"""The pass over a log as a program that JAX traces: what every engine computes."""

from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from kedge.core.beliefs import Ensemble, Gaussian, Particles
from kedge.core.contracts import AbstractFilter
from kedge.core.verdicts import Verdict
from kedge.estimation import views
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig
from kedge.estimation.step import FilterState, Outcome, begin, predict_to, process_scheduled
from kedge.estimation.transition import is_smoothable

if TYPE_CHECKING:
    import pandas

CLOUDS = Ensemble, Particles
"""Beliefs whose moments have to be computed from all their states."""


class Estimates(NamedTuple):
    """What a filter believed after each event, and what became of each reading."""

    time: Float[Array, "*T"]
    """s since the log's start."""
    moments: Gaussian
    outcome: Outcome

    @property
    def log_likelihood(self) -> Float[Array, "*runs"]:
        r"""Of all readings that were fused: $\sum_k \log p(z_k \mid z_{1:k-1})$.

        Source: F. Schweppe, "Evaluation of likelihood functions for Gaussian signals", IEEE
        Transactions on Information Theory 11(1), 1965.
        """
        fused = self.outcome.verdict == Verdict.FUSED
        return jnp.sum(jnp.where(fused, self.outcome.log_likelihood, 0.0), axis=-1)

    def to_pandas(self) -> "pandas.DataFrame":
        """A row for each event: see :func:`kedge.estimation.views.table`."""
        return views.table(self)

    def plot(self, ax: Any = None, field: str = "") -> Any:
        """Draw it, and return the axes: see :func:`kedge.estimation.views.plot`."""
        return views.plot(self, ax, field)

    def _repr_html_(self) -> str:
        return views.summary(self)


def pass_over(
    filter: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray, keep: bool
) -> tuple[Estimates, Any]:
    """Scan a filter over a log, for callers that batch or compile it themselves.

    Parameters must be arrays already; with ``keep`` the second result is the history.
    """
    return whole_pass(filter, rig, log, key, keep)[:2]


def whole_pass(
    filter: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray, keep: bool
) -> tuple[Estimates, Any, Any]:
    """The same, and the state after the last event."""
    record = keep and is_smoothable(filter)

    def body(carry: tuple[FilterState, Any], event: Any) -> tuple[Any, Any]:
        state, known = carry
        (time, sensor, row), control = event
        # Older than the belief: nothing happens, and the event does not count (as online).
        late = time < state.time
        changed = (time > state.time) | (sensor >= 0)
        state, history = predict_to(filter, rig.vehicle, state, control, time, key, record)
        fired = jnp.where(late, -1, sensor)
        state, outcome = process_scheduled(
            filter, rig.sensors, state, log.readings, fired, row, key
        )
        verdict = jnp.where(late & (sensor >= 0), Verdict.LATE, outcome.verdict)
        outcome = outcome._replace(verdict=verdict)
        moments = _moments(state.belief, changed, known)
        known = known if known is None else moments
        return (state, known), (moments, outcome, history)

    filter = filter.bind_sensors(rig.names)
    first = begin(filter, rig, key)
    known = first.belief.moments() if isinstance(first.belief, CLOUDS) else None
    events = log.schedule, log.controls
    (last, _), (moments, outcome, history) = lax.scan(body, (first, known), events)
    return Estimates(log.schedule.time, moments, outcome), history, last


def _moments(belief: Any, changed: Bool[Array, ""], known: Gaussian | None) -> Gaussian:
    """Of a cloud only where it has changed; of all else they are at hand."""
    if known is None:
        return belief.moments()
    return lax.cond(changed, belief.moments, lambda: known)
