"""Walks through a traced program and computes with nodes in place of arrays."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import Jaxpr, Literal

from kedge.compiler.functions import Functions
from kedge.compiler.graph import Unsupported
from kedge.compiler.values import Opaque, Stored, Value, constants, literal

Rule = Callable[..., Any]
"""``rule(interpreter, equation, *values)``: the value of an equation, or a list of them."""
RULES: dict[str, Rule] = {}


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Register how operations of these names are computed."""

    def register(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


class Interpreter:
    """Evaluates equations; what has no rule is an error only where its value is needed."""

    def __init__(self, functions: Functions):
        self.functions = functions

    def run(self, jaxpr: Jaxpr, consts: Sequence[Any], values: Sequence[Value]) -> list[Value]:
        """Results of a program for the values of its arguments."""
        known: dict[Any, Value] = {}
        for variable, const in zip(jaxpr.constvars, consts, strict=True):
            known[variable] = self.constant(const)
        known.update(zip(jaxpr.invars, values, strict=True))

        def read(atom: Any) -> Value:
            return literal(self.functions, atom) if isinstance(atom, Literal) else known[atom]

        for equation in jaxpr.eqns:
            results = self.compute(equation, [read(atom) for atom in equation.invars])
            known.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def constant(self, value: Any) -> Value:
        """A value that the program closes over."""
        if isinstance(value, (np.ndarray, Stored, Opaque)) and (
            not isinstance(value, np.ndarray) or value.dtype == object
        ):
            return value
        try:
            return constants(self.functions, value)
        except (Unsupported, TypeError) as error:
            return Opaque(str(error))

    def compute(self, equation: Any, values: Sequence[Value]) -> list[Value]:
        """Results of one equation."""
        name, outputs = equation.primitive.name, len(equation.outvars)
        compute = RULES.get(name)
        if compute is None:
            return [Opaque(f"operation {name!r}")] * outputs
        takes_any = getattr(compute, "takes_any", False)
        if not takes_any:
            unknown = next((v for v in values if isinstance(v, Opaque)), None)
            if unknown is not None:
                return [unknown] * outputs
            values = [self.nodes(v) for v in values]
        results = compute(self, equation, *values)
        return results if isinstance(results, list) else [results]

    def nodes(self, value: Value) -> np.ndarray:
        """A value taken apart.

        Raises:
            Unsupported: it cannot be.
        """
        if isinstance(value, Opaque):
            raise Unsupported(value.why)
        return value.nodes(self.functions) if isinstance(value, Stored) else value


def takes_any(function: Rule) -> Rule:
    """Mark a rule that looks itself at what is in memory or may not be looked at."""
    function.takes_any = True  # pyright: ignore[reportFunctionMemberAccess]
    return function
