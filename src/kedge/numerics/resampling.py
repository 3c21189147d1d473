"""Resampling of weighted particles."""

import jax.numpy as jnp
import jax.random as jr
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float, Int, PRNGKeyArray


def effective_sample_size(log_weights: Float[Array, " N"]) -> Float[Array, ""]:
    r"""$1 / \sum_i w_i^2$ of normalised weights.

    Source: A. Kong, J. Liu, W. Wong, "Sequential imputations and Bayesian missing data
    problems", J. Am. Stat. Assoc. 89, 1994.
    """
    return jnp.exp(-logsumexp(2 * log_weights))


def systematic(key: PRNGKeyArray, weights: Float[Array, " N"]) -> Int[Array, " N"]:
    r"""Ancestors by one uniform draw: particle i gets $\lfloor N w_i \rfloor$ or one more.

    Source: G. Kitagawa, "Monte Carlo filter and smoother for non-Gaussian nonlinear state
    space models", J. Comput. Graph. Stat. 5(1), 1996.
    """
    count = weights.shape[0]
    ticks = (jnp.arange(count) + jr.uniform(key)) / count
    return jnp.clip(jnp.searchsorted(jnp.cumsum(weights), ticks), 0, count - 1)
