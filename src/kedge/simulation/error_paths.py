"""Errors of sensors with a memory, as they are in simulation where no vehicle carries them."""

import functools as ft
from typing import Annotated, Any, NamedTuple, get_type_hints

import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.manifolds import space_of
from kedge.core.quantities import Scalar
from kedge.estimation.error_states import error_states
from kedge.estimation.rig import Installation
from kedge.simulation.scenario import History


def stationary(
    key: PRNGKeyArray,
    count: int,
    dt: Scalar,
    std: Float[Array, " k"],
    time_constant: Float[Array, " k"],
) -> Float[Array, "n k"]:
    r"""A Gauss-Markov process at 0, dt, 2 dt, ...: $e' = a e + \sqrt{1 - a^2} \sigma w$.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 8.4.
    """
    white = jr.normal(key, (count, len(std))) * std[None]
    decay = jnp.exp(-dt / time_constant)
    fresh = jnp.sqrt(-jnp.expm1(-2 * dt / time_constant))

    def body(before: Array, shock: Array) -> tuple[Array, Array]:
        after = decay * before + fresh * shock
        return after, after

    _, path = lax.scan(body, white[0], white[1:])
    return jnp.concatenate([white[:1], path])


def with_error_states(
    history: History, installation: Installation, dt: float, key: PRNGKeyArray
) -> History:
    """The history of a world that knows nothing of a sensor's errors, with these."""
    states = {
        name: state
        for name, state in error_states(installation).items()
        if not hasattr(history.path, name)
    }
    if not states:
        return history
    steps = len(history.path[0])
    paths = {
        name: stationary(
            jr.fold_in(key, number),
            steps + 1,
            dt,
            state.std,
            jnp.asarray(state.process.time_constant),
        )
        for number, (name, state) in enumerate(states.items())
    }
    extra = tuple((name, state.chart) for name, state in states.items())
    cls = _with_fields(type(history.path), extra)
    path = cls(*history.path, *(path[1:] for path in paths.values()))
    start = cls(*history.start, *(path[0] for path in paths.values()))
    return history._replace(path=path, start=start)


def widening_errors(
    installation: Installation, steps: int, dt: float, key: PRNGKeyArray
) -> Float[Array, "K targets m"] | None:
    """The errors at the end of each step of a sensor that filters give a wider noise for."""
    error = installation.error
    if error is None or error.is_state:
        return None
    size = space_of(installation.sensor.measures).size
    targets = (installation.targets or 1) if error.by_target else 1
    std, memory = (
        jnp.tile(jnp.broadcast_to(jnp.asarray(values, float), (size,)), targets)
        for values in (error.std, error.time_constant)
    )
    return stationary(key, steps, dt, std, memory).reshape(steps, targets, size)


@ft.cache
def _with_fields(cls: Any, extra: tuple[tuple[str, Any], ...]) -> Any:
    hints = get_type_hints(cls, include_extras=True)
    fields = [*hints.items(), *((name, Annotated[Any, chart]) for name, chart in extra)]
    create: Any = NamedTuple
    return create(f"{cls.__name__}WithErrors", fields)
