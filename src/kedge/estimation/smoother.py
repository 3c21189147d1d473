"""Fixed-interval smoothing: every estimate in the light of all readings of the log."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter
from kedge.core.manifolds import space_of
from kedge.estimation.batch import Estimates, estimate_with_history
from kedge.estimation.log import Log, Recording
from kedge.estimation.rig import Rig
from kedge.estimation.transition import EnsembleHistory, History
from kedge.numerics.linalg import symmetric


def smooth(
    filter: AbstractFilter, rig: Rig, log: Log | Recording, key: PRNGKeyArray | None = None
) -> tuple[Estimates, Estimates]:
    """The filter's estimates and the smoothed ones.

    JAX's transformations go through it, as through :func:`kedge.estimate`.

    Raises:
        ContractError: the filter carries neither a Gaussian nor an ensemble.
    """
    filtered, history = estimate_with_history(filter, rig, log, key)
    return filtered, filtered._replace(moments=rauch_tung_striebel(filtered.moments, history))


def compile_smoother(
    filtered: Gaussian, history: History | EnsembleHistory
) -> Callable[[], Gaussian]:
    """Compile the backward pass without running it."""
    jitted: Any = rauch_tung_striebel
    compiled = jitted.lower(filtered, history).compile()
    return lambda: compiled(filtered, history)


@eqx.filter_jit
def rauch_tung_striebel(filtered: Gaussian, history: History | EnsembleHistory) -> Gaussian:
    r"""Correct each filtered Gaussian by the smoothed one after it.

    $G = C_{k,k+1} (P^-_{k+1})^{-1}$, $x^s_k = x_k \boxplus G (x^s_{k+1} \boxminus x^-_{k+1})$,
    $P^s_k = P_k + G (P^s_{k+1} - P^-_{k+1}) G^\top$, with the cross-covariance C that the
    filter's own rule gave at the prediction: one smoother for every Gaussian filter. For an
    ensemble G comes from its anomalies, and mean and covariance are its sample moments.

    Source: S. Särkkä, "Bayesian Filtering and Smoothing", 2013, sections 8.2 and 9.1.
    """

    def body(later: Gaussian, event: tuple[Gaussian, Any]):
        present, record = event
        smoothed = backward(present, later, record)
        return smoothed, smoothed

    last = jax.tree.map(lambda leaf: leaf[-1], filtered)
    before = jax.tree.map(lambda leaf: leaf[:-1], filtered)
    after = jax.tree.map(lambda leaf: leaf[1:], history)
    _, smoothed = lax.scan(body, last, (before, after), reverse=True)
    return jax.tree.map(lambda head, end: jnp.concatenate([head, end[None]]), smoothed, last)


def backward(present: Gaussian, later: Gaussian, record: History | EnsembleHistory) -> Gaussian:
    """One step of :func:`rauch_tung_striebel`: ``record`` leads from present to later."""
    states = space_of(type(present.mean))
    predicted, G = record.predicted, record.smoothing_gain()
    mean = states.boxplus(present.mean, G @ states.boxminus(later.mean, predicted.mean))
    return Gaussian(mean, symmetric(present.cov + G @ (later.cov - predicted.cov) @ G.T))
