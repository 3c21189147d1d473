"""Of a bank of hypotheses the start whose pass foresaw a log best: that pass is smoothed."""

import dataclasses

import jax
import jax.random as jr
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractFilter
from kedge.estimation.compiled import Engine
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig, as_arrays
from kedge.estimation.runner import Runner
from kedge.estimation.traced import Estimates
from kedge.filters.wrappers.hypotheses import TAILS, Hypotheses


def best_start(
    filter: Hypotheses,
    rig: Rig,
    log: Log,
    key: PRNGKeyArray | None = None,
    engine: Engine = "auto",
) -> tuple[AbstractFilter, Rig]:
    r"""The bank's inner filter, and the rig with the most probable of its starts as prior.

    $\hat k = \arg\max_k \log w_k + \sum_t \log t_\nu(z_t \mid k)$ over passes from each start,
    with the bank's own heavy tails. One trajectory can be smoothed; a mixture of them cannot.

    Raises:
        ContractError: the inner filter cannot run on the rig, or the engine not run it.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking
    and Navigation", 2001, section 11.6.2 (static multiple models).
    """
    bank = filter.init(rig.prior, jr.key(0) if key is None else key)
    rigs = [
        dataclasses.replace(rig, prior=jax.tree.map(lambda leaf, k=k: leaf[k], bank.components))
        for k in range(filter.count)
    ]
    given = [as_arrays((filter.inner, one, log)) for one in rigs]
    runner = Runner(given[0], key, engine=engine)
    runner.compile(given[0])
    scores = np.asarray(bank.log_weights) + [_foreseen(runner.over(one)[0]) for one in given]
    return filter.inner, rigs[int(np.argmax(scores))]


def _foreseen(estimates: Estimates) -> float:
    """Sum over all readings that were judged, those that a gate refused too.

    The determinant of S is taken for the product of its diagonal: an outcome has no more.
    """
    outcome = estimates.outcome
    nis, dof = np.asarray(outcome.nis), np.asarray(outcome.dof)
    with np.errstate(all="ignore"):
        level = -np.nansum(np.log(np.asarray(outcome.std)), axis=1)
        values = level - (TAILS + dof) / 2 * np.log1p(nis / TAILS)
    return float(values[(dof > 0) & np.isfinite(values)].sum())
