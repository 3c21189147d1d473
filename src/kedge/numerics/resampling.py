r"""Weighing and resampling of particles, in logarithms of weights throughout.

A scheme takes a key and log weights (they need not sum to one) and returns the ancestor of
each new particle. Each is unbiased: particle i is chosen $N w_i$ times in the mean. If no
weight is above zero, all count the same: whoever calls looks at the evidence for that.

Source: N. Chopin and O. Papaspiliopoulos, "An Introduction to Sequential Monte Carlo", 2020,
chapter 9; R. Douc, O. Cappé, E. Moulines, "Comparison of resampling schemes for particle
filtering", ISPA 2005.
"""

from collections.abc import Callable

import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float, Int, PRNGKeyArray, Shaped

NOTHING = -1e30
"""Log of a weight that is none: finite, so that beliefs are, and beyond any likelihood."""


def normalised(log_weights: Float[Array, " N"]) -> tuple[Float[Array, " N"], Float[Array, ""]]:
    r"""Log weights that sum to one, and $\log \sum_i w_i$ of those given.

    A weight that is NaN counts as zero, and a zero comes back as :data:`NOTHING`. If none is
    above zero the sum is $-\infty$, and the weights returned are equal.
    """
    known = jnp.where(jnp.isnan(log_weights), -jnp.inf, log_weights)
    total = logsumexp(known)
    some = jnp.isfinite(total) & (total > NOTHING / 2)
    equal = jnp.full_like(known, -jnp.log(known.shape[0]))
    shares = jnp.where(some, jnp.maximum(known - total, NOTHING), equal)
    return shares, jnp.where(some, total, -jnp.inf)


def effective_sample_size(log_weights: Float[Array, " N"]) -> Float[Array, ""]:
    r"""$(\sum_i w_i)^2 / \sum_i w_i^2$: how many particles count; 0 if none does.

    Source: A. Kong, J. Liu, W. Wong, "Sequential imputations and Bayesian missing data
    problems", J. Am. Stat. Assoc. 89, 1994.
    """
    shares, total = normalised(log_weights)
    return jnp.where(jnp.isfinite(total), jnp.exp(-logsumexp(2 * shares)), 0.0)


def systematic(key: PRNGKeyArray, log_weights: Float[Array, " N"]) -> Int[Array, " N"]:
    r"""Ticks $(i + u) / N$ of one uniform draw: $\lfloor N w_i \rfloor$ copies or one more.

    Source: G. Kitagawa, "Monte Carlo filter and smoother for non-Gaussian nonlinear state
    space models", J. Comput. Graph. Stat. 5(1), 1996.
    """
    place = _cumulated(log_weights) * log_weights.shape[0]
    return _ancestors(jnp.ceil(place - jr.uniform(key, dtype=place.dtype)))


def stratified(key: PRNGKeyArray, log_weights: Float[Array, " N"]) -> Int[Array, " N"]:
    r"""Ticks $(i + u_i) / N$ of independent draws: fewer than two away from $N w_i$ copies.

    Source: G. Kitagawa, "Monte Carlo filter and smoother for non-Gaussian nonlinear state
    space models", J. Comput. Graph. Stat. 5(1), 1996.
    """
    count = log_weights.shape[0]
    place = _cumulated(log_weights) * count
    stratum = jnp.floor(place)
    draws = jr.uniform(key, (count,), place.dtype)
    draw = draws[jnp.minimum(stratum.astype(jnp.int32), count - 1)]
    return _ancestors(stratum + (draw < place - stratum))


def residual(key: PRNGKeyArray, log_weights: Float[Array, " N"]) -> Int[Array, " N"]:
    r"""$\lfloor N w_i \rfloor$ copies for certain; the rest drawn from what is left over.

    Source: J. Liu and R. Chen, "Sequential Monte Carlo methods for dynamic systems", J. Am.
    Stat. Assoc. 93, 1998.
    """
    count = log_weights.shape[0]
    share = count * jnp.exp(normalised(log_weights)[0])
    # A share that is whole but for rounding is whole: equal weights are left as they are.
    certain = jnp.floor(share * (1 + 64 * jnp.finfo(share.dtype).eps))
    filled = _sum_so_far(certain)
    copies = filled[-1].astype(jnp.int32)
    drawn = _independent(key, jnp.log(jnp.maximum(share - certain, 0)), count - copies)
    # The draws stand at the front and belong behind the copies.
    behind = drawn[(jnp.arange(count) - copies) % count]
    return jnp.where(jnp.arange(count) < copies, _ancestors(filled), behind)


def multinomial(key: PRNGKeyArray, log_weights: Float[Array, " N"]) -> Int[Array, " N"]:
    r"""N independent draws, as the bootstrap filter was first published.

    The draws come sorted, from exponential spacings, so that no sort is needed.

    Source: N. Gordon, D. Salmond, A. Smith, "Novel approach to nonlinear/non-Gaussian
    Bayesian state estimation", IEE Proc. F 140(2), 1993; L. Devroye, "Non-Uniform Random
    Variate Generation", 1986, section V.3.
    """
    return _independent(key, log_weights, jnp.asarray(log_weights.shape[0]))


SCHEMES: dict[str, Callable[[PRNGKeyArray, Float[Array, " N"]], Int[Array, " N"]]] = {
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
    "multinomial": multinomial,
}
"""The resampling schemes by the word that chooses them."""


def _cumulated(log_weights: Float[Array, " N"]) -> Float[Array, " N"]:
    """Shares summed up to each particle; from the last that has weight on, exactly 1."""
    sums = _sum_so_far(jnp.exp(normalised(log_weights)[0]))
    return sums / sums[-1]


def _sum_so_far(values: Shaped[Array, " N"]) -> Shaped[Array, " N"]:
    """Sum of the values up to each."""

    def one_by_one(values: Shaped[Array, " N"]) -> Shaped[Array, " N"]:
        def add(total: Array, value: Array) -> tuple[Array, Array]:
            return total + value, total + value

        return lax.scan(add, jnp.zeros((), values.dtype), values)[1]

    # On a CPU jnp.cumsum takes two to four times as long, and as long again to compile.
    return lax.platform_dependent(values, cpu=one_by_one, default=jnp.cumsum)


def _ancestors(upto: Float[Array, " N"]) -> Int[Array, " N"]:
    """Who fills each place, from how many places are filled up to each particle.

    Counting and summing up takes time in N; searching each place would take N log N.
    """
    count = upto.shape[0]
    ends = jnp.clip(upto, 0, count).astype(jnp.int32)
    closing = jnp.zeros(count + 1, jnp.int32).at[ends].add(1, indices_are_sorted=True)
    before = _sum_so_far(closing)[:count]
    return jnp.minimum(before, count - 1)


def _independent(
    key: PRNGKeyArray, log_weights: Float[Array, " N"], draws: Int[Array, ""]
) -> Int[Array, " N"]:
    """As many independent draws as asked for, sorted; what follows them means nothing."""
    count = log_weights.shape[0]
    cumulated = _cumulated(log_weights)
    spacings = jr.exponential(key, (count + 1,), cumulated.dtype)
    points = _sum_so_far(jnp.where(jnp.arange(count + 1) <= draws, spacings, 0.0))
    ticks = points[:-1] / points[-1]
    last = jnp.searchsorted(cumulated, cumulated[-1])
    return jnp.minimum(jnp.searchsorted(cumulated, ticks, side="right"), last)
