"""Long logs on machines with many cores: all events at once, by an associative scan.

The depth of the computation grows with the logarithm of the number of events, its work is a
constant factor above that of the sequential scan; on a machine with few cores that one wins.
Gates and robust noise look at one reading after the other and are refused.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.manifolds import space, space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates
from kedge.estimation.log import Log
from kedge.estimation.reading import bind_reading
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.step import FilterState, Outcome, advance, process_scheduled
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.gaussian.recursion import (
    AbstractMomentFilter,
    expectation_of,
    motion,
    moved,
    turned,
)
from kedge.numerics import associative
from kedge.numerics.associative import Affine, FilterElement
from kedge.numerics.noise import process_std


def estimate_in_parallel(rig: Rig, log: Log) -> Estimates:
    """The Kalman filter's estimates, like ``estimate(Kalman(), rig, log)``.

    Raises:
        ContractError: the model is not linear, or a sensor is gated or robust.
    """
    return smooth_in_parallel(rig, log)[0]


def smooth_in_parallel(
    rig: Rig, log: Log, iterations: int = 0, initial: Any = None
) -> tuple[Estimates, Estimates]:
    """The filter's estimates and the smoothed ones, like ``smooth(Kalman(), rig, log)``.

    With ``iterations`` the model may be nonlinear: it is linearised along a trajectory, the
    linear problem is smoothed, and the smoothed trajectory is the next one to linearise along
    (Gauss-Newton for the most probable trajectory). ``initial`` is the first, one state for
    each event; without it the vehicle drives from the prior's mean as it was told. Outcomes
    are those of the extended filter, from the filtered belief at the event before.

    Every reading needs noise in all its components.

    Raises:
        ContractError: without ``iterations``, the model is not linear; or a sensor is gated
            or robust.

    Source: F. Yaghoobi, A. Corenflos, S. Hassan, S. Särkkä, "Parallel iterated extended and
    sigma-point Kalman smoothers", ICASSP 2021.
    """
    for sensor in rig.sensors:
        if sensor.gate is not None or sensor.robust is not None:
            raise ContractError(
                f"sensor {sensor.name!r} has a gate or robust noise, which judge a reading by "
                "those before it; the parallel filter takes all at once: use 'estimate'"
            )
    if iterations < 0:
        raise ContractError(f"iterations is {iterations}, must be at least 0")
    rig, log, initial = as_arrays((rig, log, initial))
    return _smooth(rig, log, iterations, initial)


class _Event(NamedTuple):
    """When and what, as every event sees it by itself."""

    time: Float[Array, "*T"]
    dt: Float[Array, "*T"]
    late: Bool[Array, "*T"]
    sensor: Int[Array, "*T"]
    row: Int[Array, "*T"]
    control: Any


@eqx.filter_jit
def _smooth(rig: Rig, log: Log, iterations: int, initial: Any) -> tuple[Estimates, Estimates]:
    filter = Kalman() if iterations == 0 else ExtendedKalman()
    events = _events(log)

    if iterations == 0:  # any line will do
        along = jax.tree.map(
            lambda leaf: jnp.broadcast_to(leaf, (len(events.time), *jnp.shape(leaf))),
            rig.prior.mean,
        )
    else:
        along = _drive(rig, events) if initial is None else initial

    # Whether a reading can be used does not depend on the state: no gate is there.
    spread = jax.vmap(lambda mean: Gaussian(mean, rig.prior.cov))(along)
    used = _outcomes(filter, rig, log, events, spread).verdict == Verdict.FUSED

    def about(along: Any) -> tuple[Gaussian, Gaussian]:
        return _linear(rig, log, filter, events, used, along)

    # A loop, so that one iteration is compiled and not all of them.
    along = lax.fori_loop(0, max(iterations - 1, 0), lambda _, last: about(last)[1].mean, along)
    filtered, smoothed = about(along)

    def passed(before: Gaussian, event: _Event) -> Gaussian:
        key = jax.random.key(0)  # none of these filters draws
        return advance(filter, rig.vehicle, before, event.control, event.dt, key)

    predicted = jax.vmap(passed)(_shifted(rig.prior, filtered), events)
    outcome = _outcomes(filter, rig, log, events, predicted)
    outcome = outcome._replace(
        verdict=jnp.where(
            events.late & (log.schedule.sensor >= 0), Verdict.LATE, outcome.verdict
        )
    )
    time = log.schedule.time
    return Estimates(time, filtered, outcome), Estimates(time, smoothed, outcome)


def _events(log: Log) -> _Event:
    time, sensor, row = log.schedule
    last = jnp.concatenate([jnp.zeros(1), lax.cummax(jnp.maximum(time, 0.0))[:-1]])
    late = time < last
    return _Event(
        time,
        jnp.where(late, 0.0, time - last),
        late,
        jnp.where(late, -1, sensor),
        row,
        log.controls,
    )


def _drive(rig: Rig, events: _Event) -> Any:
    """Where the vehicle would be after each event without noise."""
    noises = space(rig.vehicle.noise_density())
    calm = noises.unflatten(noises.zeros())

    def body(state: Any, event: _Event) -> tuple[Any, Any]:
        state = lax.cond(
            event.dt > 0,
            lambda: rig.vehicle.step(state, event.control, calm, event.dt),
            lambda: state,
        )
        return state, state

    return lax.scan(body, rig.prior.mean, events)[1]


def _outcomes(
    filter: AbstractMomentFilter, rig: Rig, log: Log, events: _Event, beliefs: Gaussian
) -> Outcome:
    """What each reading is to the belief at its event."""

    def judge(belief: Gaussian, event: _Event) -> Outcome:
        return process_scheduled(
            filter,
            rig.sensors,
            FilterState(belief, time=event.time),
            log.readings,
            event.sensor,
            event.row,
            jax.random.key(0),
        )[1]

    return jax.vmap(judge)(beliefs, events)


def _linear(
    rig: Rig,
    log: Log,
    filter: AbstractMomentFilter,
    events: _Event,
    used: Bool[Array, " T"],
    along: Any,
) -> tuple[Gaussian, Gaussian]:
    """Filter and smooth the model linearised along a trajectory, in errors about it."""
    states = space_of(type(rig.prior.mean))
    previous = jax.tree.map(
        lambda first, leaf: jnp.concatenate([jnp.asarray(first)[None], leaf[:-1]]),
        rig.prior.mean,
        along,
    )
    motions = jax.vmap(lambda *a: _motion(rig, filter, *a))(previous, along, events)
    elements = jax.vmap(lambda *a: _element(rig, log, filter, *a))(motions, along, events, used)
    prior = associative.known(states.zeros(), rig.prior.cov)
    elements = jax.tree.map(
        lambda first, rest: jnp.concatenate([first[None], rest]), prior, elements
    )
    scanned = lax.associative_scan(jax.vmap(associative.after), elements)
    means, covs = scanned.b[1:], scanned.C[1:]

    following = jax.tree.map(lambda leaf: leaf[1:], motions)
    pulls = jax.vmap(associative.given_later)(means[:-1], covs[:-1], following)
    last = associative.final(means[-1], covs[-1])
    pulls = jax.tree.map(lambda rest, end: jnp.concatenate([rest, end[None]]), pulls, last)
    back = lax.associative_scan(jax.vmap(associative.before), pulls, reverse=True)

    def about(state: Any, error: Float[Array, " n"], cov: Float[Array, "n n"]) -> Gaussian:
        mean, turn = moved(state, error)
        return Gaussian(mean, turned(turn, cov))

    return jax.vmap(about)(along, means, covs), jax.vmap(about)(along, back.g, back.L)


def _motion(
    rig: Rig, filter: AbstractMomentFilter, before: Any, at: Any, event: _Event
) -> Affine:
    """The event's motion of errors about ``before`` to errors about ``at``."""
    states, vehicle = space(at), rig.vehicle
    # Where no time passes, any other span keeps the unused side finite.
    moving = event.dt > 0
    dt = jnp.where(moving, event.dt, 1.0)
    std = process_std(vehicle, dt)
    step = motion(vehicle, before, event.control, dt)
    if isinstance(filter, Kalman):
        filter.strategy().propagated(step, rig.prior.cov, std)  # refuses what is not linear

    def ahead(joint: Float[Array, " nw"]) -> Float[Array, " n"]:
        return states.boxminus(step(*jnp.split(joint, [states.size])), at)

    def still(error: Float[Array, " n"]) -> Float[Array, " n"]:
        return states.boxminus(states.boxplus(before, error), at)

    origin = jnp.zeros(states.size + std.shape[0])
    slope, effect = jnp.split(jax.jacfwd(ahead)(origin), [states.size], axis=1)
    spread = effect * std[None]
    moved_on = Affine(slope, ahead(origin), spread @ spread.T)
    stay = Affine(
        jax.jacfwd(still)(states.zeros()),
        still(states.zeros()),
        jnp.zeros_like(moved_on.Q),
    )
    return jax.tree.map(lambda a, b: jnp.where(moving, a, b), moved_on, stay)


def _element(
    rig: Rig,
    log: Log,
    filter: AbstractMomentFilter,
    passing: Affine,
    at: Any,
    event: _Event,
    used: Bool[Array, ""],
) -> FilterElement:
    """The event's motion and reading."""

    def silent() -> FilterElement:
        return associative.unseen(passing)

    def branch(installation: Any, rows: Any) -> Any:
        if len(rows.target) == 0:
            return silent

        def use() -> FilterElement:
            reading = jax.tree.map(lambda leaf: leaf[event.row], rows)
            model, measurement = bind_reading(installation, reading)
            expect, outputs = expectation_of(model, at), space(measurement)
            if isinstance(filter, Kalman):
                filter.strategy().propagated(expect, rig.prior.cov)

            def away(error: Float[Array, " n"]) -> Float[Array, " m"]:
                return outputs.boxminus(measurement, expect(error))

            origin = jnp.zeros(space(at).size)
            slope = -jax.jacfwd(away)(origin)
            return associative.seen(passing, away(origin), slope, model.noise_cov(at))

        return use

    branches = [silent, *map(branch, rig.sensors, log.readings)]
    chosen = lax.switch(event.sensor + 1, branches)
    return jax.tree.map(lambda a, b: jnp.where(used, a, b), chosen, silent())


def _shifted(prior: Gaussian, filtered: Gaussian) -> Gaussian:
    """The belief before each event."""
    return jax.tree.map(
        lambda first, leaf: jnp.concatenate([jnp.asarray(first)[None], leaf[:-1]]),
        Gaussian(prior.mean, prior.cov),
        filtered,
    )
