"""Rules of programs within programs: calls, branches, and loops short enough to be unrolled."""

import math
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr

from kedge.compiler.elementwise import each
from kedge.compiler.graph import Node, Unsupported
from kedge.compiler.interpret import Interpreter, rule, takes_any
from kedge.compiler.values import Opaque, Value, filled

MOST_ROUNDS = 64
"""Of a loop that is unrolled."""


@rule("jit", "custom_jvp_call", "custom_vjp_call", "custom_vmap_call", "remat2", "checkpoint")
@takes_any
def _call(interpreter: Interpreter, equation: Any, *values: Value) -> list[Value]:
    params = equation.params
    inside = next(params[name] for name in ("jaxpr", "call_jaxpr", "call") if name in params)
    return _run(interpreter, inside, values)


def _run(interpreter: Interpreter, program: Any, values: Any) -> list[Value]:
    if isinstance(program, ClosedJaxpr):
        return interpreter.run(program.jaxpr, program.consts, values)
    return interpreter.run(program, (), values)


@rule("platform_index")
@takes_any
def _platform(interpreter: Interpreter, equation: Any, *_: Value) -> np.ndarray:
    platforms = equation.params["platforms"]
    for place, names in enumerate(platforms):
        if names is None or "cpu" in names:
            return filled([interpreter.functions.const(place, "i4")], ())
    raise Unsupported("a branch by platform without one for the processor")


@rule("cond")
@takes_any
def _cond(interpreter: Interpreter, equation: Any, which: Value, *values: Value) -> list[Value]:
    f, branches = interpreter.functions, equation.params["branches"]
    index = f.convert(interpreter.nodes(which).item(), "i8")
    index = f.clamp(f.const(0, "i8"), index, f.const(len(branches) - 1, "i8"))
    if index.is_const:
        return _run(interpreter, branches[index.param[1]], values)
    if index.varying:
        return _every(interpreter, index, [_run(interpreter, b, values) for b in branches])

    unknown: list[Opaque] = []

    def case(branch: Any) -> list[Node | None]:
        nodes: list[Node | None] = []
        for value, atom in zip(
            _run(interpreter, branch, values), equation.outvars, strict=True
        ):
            if isinstance(value, Opaque):
                unknown.append(value)
                nodes += [None] * math.prod(atom.aval.shape)
            else:
                nodes += list(interpreter.nodes(value).flat)
        return nodes

    merged = f.graph.branch(index, [lambda b=b: case(b) for b in branches])
    out: list[Value] = []
    begin = 0
    for atom in equation.outvars:
        size = math.prod(atom.aval.shape)
        known = [node for node in merged[begin : begin + size] if node is not None]
        begin += size
        whole = len(known) == size
        out.append(filled(known, atom.aval.shape) if whole else unknown[0])
    return out


def _every(interpreter: Interpreter, index: Node, cases: list[list[Value]]) -> list[Value]:
    """All cases computed, since runs differ in which they need; each takes its own."""
    f, out = interpreter.functions, []
    for values in zip(*cases, strict=True):
        if any(isinstance(v, Opaque) for v in values):
            out.append(Opaque("a branch that is not known"))
            continue
        choice = interpreter.nodes(values[-1])
        for place in reversed(range(len(values) - 1)):
            here = f.compare("eq", index, f.const(place, "i8"))
            choice = each(
                lambda a, b, here=here: f.select(here, a, b),
                interpreter.nodes(values[place]),
                choice,
            )
        out.append(choice)
    return out


@rule("scan")
@takes_any
def _scan(interpreter: Interpreter, equation: Any, *values: Value) -> list[Value]:
    """A loop of few rounds, one after the other."""
    params = equation.params
    rounds, inside = params["length"], params["jaxpr"]
    if rounds > MOST_ROUNDS:
        return [Opaque(f"a loop of {rounds} rounds")] * len(equation.outvars)
    fixed, carried = params["num_consts"], params["num_carry"]
    consts, carry = list(values[:fixed]), list(values[fixed : fixed + carried])
    inputs = values[fixed + carried :]
    if any(isinstance(v, Opaque) for v in (*carry, *inputs)):
        return [Opaque("a loop over what is not known")] * len(equation.outvars)
    rows = [interpreter.nodes(v) for v in inputs]
    outputs: list[list[Value]] = []
    order = reversed(range(rounds)) if params["reverse"] else range(rounds)
    for i in order:
        results = _run(interpreter, inside, [*consts, *carry, *(row[i, ...] for row in rows)])
        carry = results[:carried]
        outputs.append(results[carried:])
    if params["reverse"]:
        outputs.reverse()
    stacked: list[Value] = []
    if rounds == 0:
        return [*carry, *(filled([], v.aval.shape) for v in equation.outvars[carried:])]
    for column in zip(*outputs, strict=True):
        if any(isinstance(v, Opaque) for v in column):
            stacked.append(Opaque("a loop over what is not known"))
            continue
        parts = [interpreter.nodes(v) for v in column]
        stacked.append(np.stack(parts))
    return [*carry, *stacked]
