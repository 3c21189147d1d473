"""Many runs of one schedule: Monte Carlo, batched in chunks that the cores share."""

import functools as ft
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Int, PRNGKeyArray

from kedge.compiler.kernel import cores
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.estimation.compiled import Engine, compiled_pass
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.traced import Estimates, pass_over
from kedge.estimation.transition import innermost
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.filters.particle.cloud import AbstractParticleFilter

CHUNK = 125
"""Runs batched in one call: enough for the vector units, few enough for the cache."""
CLOUDS = 16
"""The same for ensembles and particles, which fill the vector units by themselves."""


def estimate_runs(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    key: PRNGKeyArray | None = None,
    keep: Callable[[Estimates], Any] = lambda estimates: estimates,
    chunk: int | None = None,
    engine: Engine = "auto",
) -> Any:
    """Run ``filter`` over logs that share a schedule; results have a leading run axis.

    ``log.controls`` and ``log.readings`` have a leading run axis; ``log.schedule`` has none,
    so that every branch on the sensor stays a branch. ``keep`` picks inside the traced program
    what is returned of each run. Run i draws from ``fold_in(key, i)``, whatever the chunk.

    Raises:
        DataError: there are no runs, or not equally many everywhere.
        ContractError: the engine asked for cannot run this.
    """
    counts = {leaf.shape[0] for leaf in jax.tree.leaves((log.controls, log.readings))}
    if len(counts) != 1 or 0 in counts:
        raise DataError(f"runs: found {sorted(counts)} of them, expected one number above 0")
    (count,) = counts
    filter, rig = as_arrays((filter, rig))
    common, per_run = (
        ft.partial(jax.tree.map, lambda _: False),
        ft.partial(jax.tree.map, lambda _: True),
    )
    flags = (
        common((filter, rig)),
        Log(common(log.schedule), per_run(log.controls), per_run(log.readings)),
    )
    native = compiled_pass(
        filter, rig, log, False, engine, keep, flags, count * len(log.schedule.time)
    )
    if native is not None:
        # It reads plain memory, so that parts need no copy, and uses all cores by itself.
        log = jax.tree.map(np.asarray, log)
        step = chunk or native.most_runs(log)
        return joined([
            native.over(filter, rig, _part(log, begin, step), min(step, count - begin))
            for begin in range(0, count, step)
        ])  # fmt: skip
    log = as_arrays(log)
    clouds = isinstance(innermost(filter), AbstractEnsembleFilter | AbstractParticleFilter)
    step = chunk or _even(count, CLOUDS if clouds else CHUNK)
    key = jr.key(0) if key is None else key

    def part(begin: int) -> Any:
        index = jnp.arange(begin, min(begin + step, count))
        some = _part(log, begin, step)
        return jax.block_until_ready(_some(filter, rig, some, index, key, keep))

    # The first call compiles.
    return joined([part(0), *shared(part, range(step, count, step))])


def shared(part: Callable[[int], Any], parts: Iterable[int]) -> list[Any]:
    """What compiled programs make of each part: the cores share them, outside Python's lock."""
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(part, parts))


def _even(count: int, most: int) -> int:
    """Runs in a batch, at most so many; batches are odd in number: the first goes alone."""
    parts = -(-count // most)
    return -(-count // (parts + 1 - parts % 2))


def _part(log: Log, begin: int, step: int) -> Log:
    part = jax.tree.map(lambda leaf: leaf[begin : begin + step], (log.controls, log.readings))
    return Log(log.schedule, *part)


def joined(parts: list[Any]) -> Any:
    """Trees of arrays, one after the other along the first axis."""
    if len(parts) == 1:
        return parts[0]
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


@eqx.filter_jit
def _some(
    filter: AbstractFilter,
    rig: Rig,
    log: Log,
    index: Int[Array, " runs"],
    key: PRNGKeyArray,
    keep: Callable[[Estimates], Any],
) -> Any:
    def one(run: Int[Array, ""], controls: Any, readings: Any) -> Any:
        one_log = Log(log.schedule, controls, readings)
        return keep(pass_over(filter, rig, one_log, jr.fold_in(key, run), False)[0])

    return jax.vmap(one)(index, log.controls, log.readings)
