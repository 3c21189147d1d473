"""The contract of a filter as a check."""

import functools as ft
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core import registry
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import ContractError
from kedge.core.manifolds import space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates, estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.online import Estimator
from kedge.estimation.replay import replay
from kedge.estimation.rig import Installation, Rig
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.testing.compiling import quick_jit
from kedge.testing.laws import Require, Tracing, member
from kedge.testing.spaces import row


def check_filter(filter: str | type | AbstractFilter) -> None:
    """Check a filter against its contract, on a matched log.

    It runs on a unicycle that sees landmarks; one that refuses nonlinear models with a
    ``ContractError`` runs on a vehicle of constant velocity with GNSS.

    Raises:
        ContractError: the first law that it breaks.
    """
    model, require = member(filter, registry.filters, AbstractFilter)
    key = jr.key(4)
    rig, log, estimates, run = _first_run(model, require, key)
    unpredicted = int((estimates.outcome.verdict == Verdict.UNPREDICTED).sum())
    require(
        "predictions are finite and have no negative variance",
        unpredicted == 0,
        found=f"{unpredicted} events that could not be predicted",
        expected="none",
    )
    silent = log.schedule._replace(sensor=np.full_like(log.schedule.sensor, -1))
    for index, label in enumerate(("as they are", "spoilt", "missing")):
        moments = row(estimates.moments, index)
        require.finite(
            f"the moments are finite, with readings {label}",
            np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(moments)]),
        )
        scale = np.abs(moments.cov).max()
        skew = np.abs(moments.cov - np.swapaxes(moments.cov, 1, 2))
        require.small("covariances are symmetric", skew, 1e-9 * scale)
        lowest = -np.linalg.eigvalsh(moments.cov).min()
        require.small("covariances have no negative eigenvalue", lowest, 1e-9 * scale)

    require(
        "the same key gives the same bytes",
        _bytes(run(log.schedule)) == _bytes(estimates),
        found="two results",
        expected="one",
    )
    verdicts = estimates.outcome.verdict[2][log.schedule.sensor >= 0]
    require(
        "a reading that is missing is not used",
        bool((verdicts == Verdict.NOT_FINITE).all()),
        found=[Verdict(verdict).name for verdict in verdicts],
        expected="NOT_FINITE",
    )
    alone, gone = row(run(silent).moments, 2), row(estimates.moments, 2)
    require.small("a missing reading leaves the prediction", _distance(alone, gone), 1e-12)

    for index in range(2):
        moments, verdicts = row((estimates.moments, estimates.outcome.verdict), index)
        same = log._replace(readings=row(log.readings, index))
        gap, verdict = _online_gap(model, rig, same, key, moments, verdicts)
        require("batch and online give the same verdicts", verdict is None, found=verdict)
        require.small("batch and online agree", gap, 1e-9)
    require(
        "readings that come late, within the lag, end at the belief of those in order",
        _told(model, rig, log, key, sorted(MUDDLED)) == _told(model, rig, log, key, MUDDLED),
        found="another belief",
        expected="the same to the last bit",
    )


@ft.cache
def _recorded(vehicle_name: str, sensor_name: str) -> tuple[Rig, Log]:
    """A rig and its log; of the readings a row as they are, one spoilt, one missing."""
    vehicle, sensor = registry.vehicles.make(vehicle_name), registry.sensors.make(sensor_name)
    start = vehicle.start()
    prior = Gaussian(start, 0.1 * jnp.eye(space_of(type(start)).size))
    rig = Rig(vehicle, (Installation(sensor_name, sensor),), prior)
    recording, _ = record(Scenario(rig, duration=3.0), jr.key(3), output_rate=5.0)
    log = jax.tree.map(np.asarray, recording.log)
    rows = log.readings, _spoilt(log.readings), _missing(log.readings)
    return rig, log._replace(readings=jax.tree.map(lambda *leaves: np.stack(leaves), *rows))


def _first_run(
    model: AbstractFilter, require: Require, key: PRNGKeyArray
) -> tuple[Rig, Log, Estimates, Callable[[Schedule], Estimates]]:
    """The first rig that the filter does not refuse, its log, and a pass over all its rows."""
    refusal = None
    for names in (("unicycle", "landmarks"), ("constant-velocity", "gnss")):
        rig, log = _recorded(*names)

        @quick_jit
        def run(schedule: Schedule, rig: Rig = rig, log: Log = log) -> Estimates:
            def once(readings: Any) -> Estimates:
                return estimate(model, rig, Log(schedule, log.controls, readings), key)

            return jax.vmap(once)(log.readings)

        with Tracing(require, "it can be traced, scanned over a log and mapped over runs"):
            try:
                estimates = jax.tree.map(np.asarray, run(log.schedule))
            except ContractError as error:
                refusal = error
            else:
                return rig, log, estimates, run
    raise ContractError(f"{require.member} refuses every vehicle: {refusal}") from refusal


def _spoilt(readings: tuple[Readings, ...]) -> tuple[Readings, ...]:
    """Components missing in turn, one infinity, one target that is not on the map."""
    spoilt = []
    for one in readings:
        leaves, structure = jax.tree.flatten(one.measurement)
        for place, leaf in enumerate(leaves):
            flat = np.array(leaf, float)
            for line in range(len(flat)):
                if flat.ndim > 1 and line % 3 == 1:
                    flat[line, line % flat.shape[1]] = np.nan
                elif flat.ndim == 1 and line % 3 == 1 and line // 3 % len(leaves) == place:
                    flat[line] = np.nan
            flat[0] = np.inf
            leaves[place] = flat
        target = np.array(one.target)
        target[2] = -1
        spoilt.append(
            one._replace(measurement=jax.tree.unflatten(structure, leaves), target=target)
        )
    return tuple(spoilt)


def _missing(readings: tuple[Readings, ...]) -> tuple[Readings, ...]:
    return tuple(
        one._replace(
            measurement=jax.tree.map(lambda z: np.full_like(z, np.nan), one.measurement)
        )
        for one in readings
    )


def _online_gap(
    model: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray, moments: Any, verdicts: Any
) -> tuple[float, str | None]:
    """The largest difference of an online run from a batch, and the first other verdict."""
    # With a lag, as below: another one is another program.
    lag = float(log.schedule.time[-1])
    online, worst = Estimator(model, rig, key, control=row(log.controls, 0), lag=lag), 0.0
    for i, (at, answer) in enumerate(
        zip(log.schedule.time.tolist(), replay(online, log), strict=True)
    ):
        worst = max(worst, _distance(answer.moments, row(moments, i)))
        if int(answer.outcome.verdict) != int(verdicts[i]):
            batch = Verdict(int(verdicts[i])).name
            return worst, f"{batch} in the batch, {answer.verdict.name} online, at {at:g} s"
    return worst, None


MUDDLED = [5, 1, 7, 0, 3, 6, 2, 4]
"""An order of the first eight readings."""


def _told(
    model: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray, order: Any
) -> list[bytes]:
    """The belief after the log's first readings, told in this order."""
    time, fired, rows = (np.asarray(part) for part in log.schedule)
    online = Estimator(model, rig, key, control=row(log.controls, 0), lag=float(time[-1]))
    events = np.flatnonzero(fired >= 0)
    for i in events[[place for place in order if place < len(events)]]:
        one = row(log.readings[fired[i]], (0, int(rows[i])))
        name, there = online.sensors[fired[i]], int(one.target)
        online.push(float(time[i]), name, one.measurement, target=there, cov=one.cov)
    return _bytes(online.belief)


def _distance(one: Gaussian, other: Gaussian) -> float:
    gaps = jax.tree.map(lambda a, b: np.max(np.abs(np.asarray(a) - np.asarray(b))), one, other)
    return float(np.max(jax.tree.leaves(gaps)))


def _bytes(tree: Any) -> list[bytes]:
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree)]
