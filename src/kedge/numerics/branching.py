"""Branches that stay branches in a batch."""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool

T = TypeVar("T")


def whenever(flag: Bool[Array, ""], rare: Callable[[], T], usual: Callable[[], T]) -> T:
    """``rare()`` where the flag is set, else ``usual()``: for what is dear and seldom needed.

    In a batch ``lax.cond`` computes both sides for all, always. This computes the rare side
    only if a flag of the batch is set, and then for all of it.
    """
    converted = eqx.filter_closure_convert(rare), eqx.filter_closure_convert(usual)
    traced, static = eqx.partition(converted, eqx.is_array)

    @custom_vmap
    def branch(flag: Any, traced: Any) -> Any:
        rare, usual = eqx.combine(traced, static)
        return lax.cond(flag, lambda: rare(), lambda: usual())

    @branch.def_vmap
    def in_batch(size: int, batched: Any, flag: Any, traced: Any) -> tuple[Any, Any]:
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, batched)

        def each(flag: Any, traced: Any) -> Any:
            rare, usual = eqx.combine(traced, static)
            return jax.tree.map(lambda a, b: jnp.where(flag, a, b), rare(), usual())

        def none(flag: Any, traced: Any) -> Any:
            return eqx.combine(traced, static)[1]()

        some, no = (jax.vmap(f, in_axes=axes, axis_size=size) for f in (each, none))
        results = lax.cond(jnp.any(flag), some, no, flag, traced)
        return results, jax.tree.map(lambda _: True, results)

    return branch(flag, traced)
