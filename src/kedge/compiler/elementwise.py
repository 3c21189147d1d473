"""Rules of operations element by element."""

from collections.abc import Callable
from typing import Any

import numpy as np

from kedge.compiler.algebra import COMPARISONS, value_of
from kedge.compiler.functions import Functions
from kedge.compiler.graph import FLOATS, Node, Unsupported
from kedge.compiler.interpret import Interpreter, rule
from kedge.compiler.values import filled, kind_of

Each = Callable[..., Node]


def each(operation: Each, *arrays: np.ndarray) -> np.ndarray:
    """An operation on equal places of arrays; axes of length 1 go with every place."""
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    lists = [(a if a.shape == shape else np.broadcast_to(a, shape)).ravel() for a in arrays]
    return filled([operation(*row) for row in zip(*lists, strict=True)], shape)


def _register(names: str, pick: Callable[[Functions, Any], Each]) -> None:
    @rule(*names.split())
    def apply(interpreter: Interpreter, equation: Any, *arrays: np.ndarray) -> np.ndarray:
        return each(pick(interpreter.functions, equation.params), *arrays)


_register("add add_any", lambda f, _: f.add)
_register("sub", lambda f, _: f.sub)
_register("mul", lambda f, _: f.mul)
_register("neg", lambda f, _: f.neg)
_register("max", lambda f, _: lambda a, b: f.extreme("max", a, b))
_register("min", lambda f, _: lambda a, b: f.extreme("min", a, b))
_register("clamp", lambda f, _: f.clamp)
_register("sin", lambda f, _: f.sine)
_register("cos", lambda f, _: lambda a: f.sine(a, 1))
_register("tan", lambda f, _: lambda a: f.div(f.sine(a), f.sine(a, 1)))
_register("log", lambda f, _: f.logarithm)
_register("atan2", lambda f, _: f.arctangent)
_register("atan", lambda f, _: lambda a: f.arctangent(a, f.const(1, a.kind)))
_register("exp", lambda f, _: f.exponential)
_register("exp2", lambda f, _: lambda a: f.call("exp2", a))
_register("square", lambda f, _: lambda a: f.mul(a, a))
_register("not", lambda f, _: f.invert)
_register("abs", lambda f, _: f.absolute)
_register("stop_gradient copy optimization_barrier", lambda f, _: _same)
for _name in ("sqrt", "floor", "ceil"):
    _register(_name, lambda f, _, name=_name: lambda a: f.unary(name, a))
for _name in ("and", "or", "xor"):
    _register(_name, lambda f, _, name=_name: lambda a, b: f.both(name, a, b))
for _name in COMPARISONS:
    _register(_name, lambda f, _, name=_name: lambda a, b: f.compare(name, a, b))
for _name in "asin acos sinh cosh tanh asinh acosh atanh log1p expm1 erf erfc cbrt".split():
    _register(_name, lambda f, _, name=_name: lambda a: f.call(name, a))
_register("lgamma", lambda f, _: lambda a: f.call("lgamma", a))
_register("rsqrt", lambda f, _: lambda a: f.div(f.const(1, a.kind), f.unary("sqrt", a)))


def _same(a: Node) -> Node:
    return a


@rule("div")
def _div(interpreter: Interpreter, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    f = interpreter.functions
    if kind_of(equation.outvars[0].aval.dtype) in FLOATS:
        return each(f.div, a, b)
    return each(lambda x, y: _whole(f, "quotient", x, y), a, b)


def _whole(f: Functions, op: str, a: Node, b: Node) -> Node:
    """Quotient or remainder of integers, towards zero; by zero it would end the process."""
    if not b.is_const or value_of(b) in (0, -1):
        raise Unsupported("division of integers by what is not known")
    if a.is_const:
        x, y = value_of(a), value_of(b)
        quotient = abs(x) // abs(y) * (1 if (x < 0) == (y < 0) else -1)
        return f.const(quotient if op == "quotient" else x - quotient * y, a.kind)
    return f.graph.make(op, a.kind, (a, b))


@rule("pow")
def _pow(interpreter: Interpreter, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    f = interpreter.functions
    return each(lambda x, y: f.call("pow", x, f.convert(y, "f8")), a, b)


@rule("integer_pow")
def _integer_pow(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    f, power = interpreter.functions, equation.params["y"]

    def raised(x: Node) -> Node:
        value, factor, remaining = None, x, abs(power)
        while remaining:
            if remaining & 1:
                value = factor if value is None else f.mul(value, factor)
            factor, remaining = f.mul(factor, factor), remaining >> 1
        one = f.const(1, x.kind)
        if value is None:
            return one
        return f.div(one, value) if power < 0 else value

    return each(raised, a)


@rule("rem")
def _rem(interpreter: Interpreter, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    f = interpreter.functions
    if a.size and a.flat[0].kind not in FLOATS:
        return each(lambda x, y: _whole(f, "remainder", x, y), a, b)
    return each(lambda x, y: f.call("fmod", x, y), a, b)


@rule("round")
def _round(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    f = interpreter.functions
    if int(equation.params["rounding_method"]) == 1:
        return each(lambda x: f.unary("even", x), a)
    return each(lambda x: f.call("round", x), a)


@rule("sign")
def _sign(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    f = interpreter.functions

    def sign(x: Node) -> Node:
        zero, one = f.const(0, x.kind), f.const(1, x.kind)
        positive = f.select(f.compare("gt", x, zero), one, x)
        return f.select(f.compare("lt", x, zero), f.neg(one), positive)

    return each(sign, a)


@rule("is_finite")
def _is_finite(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    f = interpreter.functions
    return each(lambda x: f.compare("lt", f.absolute(x), f.const(float("inf"), x.kind)), a)


@rule("select_n")
def _select_n(
    interpreter: Interpreter, equation: Any, which: np.ndarray, *cases: np.ndarray
) -> np.ndarray:
    f = interpreter.functions
    if which.flat[0].kind == "b1" if which.size else True:
        return each(lambda w, no, yes: f.select(w, yes, no), which, *cases)

    def pick(w: Node, *values: Node) -> Node:
        choice = values[-1]
        for place in reversed(range(len(values) - 1)):
            choice = f.select(f.compare("eq", w, f.const(place, w.kind)), values[place], choice)
        return choice

    return each(pick, which, *cases)


@rule("convert_element_type")
def _convert(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    kind = kind_of(equation.params["new_dtype"])
    return each(lambda x: interpreter.functions.convert(x, kind), a)


@rule("shift_left", "shift_right_logical", "shift_right_arithmetic")
def _shift(interpreter: Interpreter, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    name = equation.primitive.name.replace("right_logical", "unsigned")
    op = name.replace("right_arithmetic", "signed")
    f = interpreter.functions

    def shift(x: Node, by: Node) -> Node:
        # A word has no such shift: nothing is left, or the sign.
        last = f.const(8 * int(x.kind[1:]) - 1, x.kind)
        over = f.compare("gt", by, last)
        if by.kind[0] == "i":
            over = f.both("or", over, f.compare("lt", by, f.const(0, by.kind)))
        within = f.graph.make(op, x.kind, (x, f.select(over, last, by)))
        beyond = within if op == "shift_signed" else f.const(0, x.kind)
        return f.select(over, beyond, within)

    return each(shift, a, b)


@rule("bitcast_convert_type")
def _bitcast(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    kind = kind_of(equation.params["new_dtype"])
    if a.shape != equation.outvars[0].aval.shape:
        raise Unsupported("the parts of a number")
    return each(lambda x: interpreter.functions.graph.make("bitcast", kind, (x,)), a)
