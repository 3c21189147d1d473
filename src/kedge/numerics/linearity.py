"""Is a traced function affine? Decided from its structure, not by trying a few points."""

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal
from jaxtyping import Array, Float


def is_affine(
    function: Callable[[Float[Array, " n"]], Float[Array, " m"]], point: Float[Array, " n"]
) -> bool:
    """Whether the Jacobian of ``function`` does not depend on where it is taken.

    The Jacobian's traced program is searched for a path from its argument to its result.
    A function that is affine but written with products of its argument counts as nonlinear.
    """
    program = jax.make_jaxpr(jax.jacfwd(function))(point)
    return not any(_reached(program.jaxpr, [True] * len(program.jaxpr.invars)))


def _reached(program: Jaxpr, tainted_inputs: list[bool]) -> list[bool]:
    """Which outputs of a program depend on the tainted inputs."""
    tainted = {v for v, t in zip(program.invars, tainted_inputs, strict=True) if t}

    def is_tainted(atom: Any) -> bool:
        return not isinstance(atom, Literal) and atom in tainted

    for equation in program.eqns:
        inputs = [is_tainted(atom) for atom in equation.invars]
        inner = equation.params.get("jaxpr")
        inner = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
        if isinstance(inner, Jaxpr) and equation.primitive.name in (
            "jit",
            "pjit",
            "closed_call",
        ):
            outputs = _reached(inner, inputs)
        else:
            outputs = [any(inputs)] * len(equation.outvars)
        tainted |= {v for v, t in zip(equation.outvars, outputs, strict=True) if t}
    return [is_tainted(atom) for atom in program.outvars]
