"""Resampling keeps every weight's share (law 11)."""

import jax
import jax.random as jr
import numpy as np
import pytest

from kedge.numerics.resampling import SCHEMES
from kedge.testing import quick_jit

COUNT = 40
RANDOM = np.random.default_rng(0)
# Even, uneven, hopeless: one particle that carries all, and many that carry nothing.
WEIGHTS = np.concatenate(
    [
        np.full((1, COUNT), 1 / COUNT),
        RANDOM.dirichlet(np.ones(COUNT), size=20),
        RANDOM.dirichlet(np.full(COUNT, 0.05), size=20),
        np.eye(COUNT)[[0, 17, COUNT - 1]],
    ]
)
with np.errstate(divide="ignore"):
    LOG_WEIGHTS = np.log(WEIGHTS)
RUNS = 4000


def counts(chosen):
    return np.stack([np.bincount(row, minlength=COUNT) for row in np.asarray(chosen)])


@pytest.fixture(scope="module", params=SCHEMES)
def scheme(request):
    return request.param, quick_jit(jax.vmap(SCHEMES[request.param]))


def test_copies_are_the_share_as_nearly_as_the_scheme_promises(scheme):
    name, draw = scheme
    keys = jr.split(jr.key(0), (RUNS // len(WEIGHTS), len(WEIGHTS)))
    every = np.tile(np.arange(len(WEIGHTS)), len(keys))
    found, share = counts(draw(keys.ravel(), LOG_WEIGHTS[every])), COUNT * WEIGHTS[every]
    assert (found.sum(axis=1) == COUNT).all()
    assert (found[WEIGHTS[every] == 0] == 0).all()
    # Where the share is whole, rounding of the sum may take it either way.
    if name in ("systematic", "residual"):
        assert (found >= np.floor(share - 1e-9)).all()
    if name == "systematic":
        assert (found <= np.ceil(share + 1e-9)).all()
    if name == "stratified":
        assert (np.abs(found - share) < 2).all()


@pytest.mark.parametrize("row", [1, 25], ids=["uneven", "few"])
def test_copies_are_the_share_in_the_mean(scheme, row):
    """E[n] = N w, within 4.5 standard errors of what was found, and a count's own grain."""
    _, draw = scheme
    found = counts(draw(jr.split(jr.key(1), RUNS), np.tile(LOG_WEIGHTS[row], (RUNS, 1))))
    share = COUNT * WEIGHTS[row]
    # No scheme spreads wider than independent draws do: binomial.
    std = np.sqrt(share * (1 - WEIGHTS[row]) / RUNS)
    assert (np.abs(found.mean(axis=0) - share) <= 4.5 * std + 1e-12).all()
    # Independent draws spread as a binomial does; the others, less.
    assert found.var(axis=0).sum() <= 1.05 * (share * (1 - WEIGHTS[row])).sum()
