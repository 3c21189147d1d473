"""Loops that stay whole: what XLA compiles apart from that which uses it."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

P = ParamSpec("P")
R = TypeVar("R")


def apart(function: Callable[P, R], static: int | tuple[int, ...] = ()) -> Callable[P, R]:
    """``function`` with its results kept in memory, not computed anew for each use.

    On a CPU XLA draws arithmetic into the loops that need it, however much it is, and as often
    as it is needed: into both sides of a concatenation, into every row of a product. A barrier
    does not stop it, as it is gone by then; a call that may not be inlined does. The function
    should have one result and no ``jnp.where``, whose own call would be kept as well.
    ``static`` are the places of arguments that are no arrays.
    """
    compiled = jax.jit(function, static_argnums=static)

    def call(*arguments: P.args, **named: P.kwargs) -> R:
        if jax.default_backend() != "cpu":
            return function(*arguments, **named)
        with set_xla_metadata(inlineable="false"):
            return compiled(*arguments, **named)

    return call
