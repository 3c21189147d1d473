"""Many runs of one schedule: Monte Carlo, batched in chunks that the cores share."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.estimation.compiled import Engine
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.runner import Runner
from kedge.estimation.traced import Estimates
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
    given = *as_arrays((filter, rig)), log
    common, per_run = (jax.tree.map(lambda _, flag=flag: flag, given) for flag in (False, True))
    flags = *common[:2], per_run[2]._replace(schedule=common[2].schedule)
    clouds = isinstance(innermost(filter), AbstractEnsembleFilter | AbstractParticleFilter)
    runner = Runner(
        given, key, keep, per_run=flags, engine=engine, work=count * len(log.schedule.time),
        at_once=chunk or _even(count, CLOUDS if clouds else CHUNK),
    )  # fmt: skip
    return runner.over_runs(given, np.arange(count))


def _even(count: int, most: int) -> int:
    """Runs in a batch, at most so many; batches are odd in number: the first goes alone."""
    parts = -(-count // most)
    return -(-count // (parts + 1 - parts % 2))
