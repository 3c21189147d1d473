"""Readings of a true state: one function, for recorded readings and for those in a loop."""

from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Int, Key, PRNGKeyArray

from kedge.core.manifolds import space
from kedge.estimation.log import Readings
from kedge.estimation.rig import Installation
from kedge.numerics.noise import coloured


def sensed(
    installation: Installation, state: Any, target: Int[Array, ""], key: PRNGKeyArray
) -> Any:
    """What a sensor measures of one target from a true state."""
    expected = installation.expect(state, target)
    outputs = space(expected)
    noise = coloured(
        jr.normal(key, (outputs.size,)),
        installation.noise_variance(state, target),
        lambda: installation.noise_cov(state, target),
    )
    return outputs.boxplus(expected, noise)


def targets_of(installation: Installation, count: int) -> Int[Array, " n"]:
    """The target of each reading: all of the map in turn."""
    return jnp.arange(count) % (installation.targets or 1)


def all_sensed(
    installation: Installation, ticks: Any, keys: Key[Array, " n"], path: Any
) -> Readings:
    """All readings of a sensor; ``ticks`` are the steps, from 1, at whose ends it fires."""
    seen = jax.tree.map(lambda leaf: leaf[ticks - 1], path)
    targets = targets_of(installation, len(ticks))

    def one(state: Any, target: Int[Array, ""], key: PRNGKeyArray) -> Any:
        return sensed(installation, state, target, key)

    return Readings(jax.vmap(one)(seen, targets, keys), targets)
