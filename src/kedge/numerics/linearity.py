"""What a traced function is like, decided from its structure: affine, differentiable."""

from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal
from jaxtyping import Array, Float

from kedge.core.errors import ContractError


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


def require_differentiable(
    function: Callable[[Float[Array, " n"]], Any],
    point: Float[Array, " n"],
    who: str,
    instead: str,
) -> None:
    """Refuse what has no derivative, or one that is zero by construction.

    The second kind rounds or compares: its value depends on the argument, its derivative does
    not, and whoever linearises it learns nothing.

    Raises:
        ContractError: naming ``who`` asks, and what to use ``instead``.
    """

    def slope(tangent: Float[Array, " n"]) -> Any:
        return jax.jvp(function, (point,), (tangent,))[1]

    # First, so that a model that cannot be computed at all fails with its own message.
    value = jax.make_jaxpr(function)(point)
    try:
        derivative = jax.make_jaxpr(slope)(point)
    except (TypeError, ValueError, NotImplementedError) as error:
        raise ContractError(
            f"{who} needs a derivative that the model has not: {str(error).splitlines()[0]}; "
            f"use {instead}"
        ) from error
    depends = any(_reached(value.jaxpr, [True]))
    if depends and not any(_reached(derivative.jaxpr, [True])):
        raise ContractError(
            f"{who} needs a derivative, but the model's is zero everywhere although its value "
            f"changes: it rounds or compares; use {instead}"
        )
