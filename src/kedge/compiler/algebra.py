"""Scalar operations that do at once what can be done without the data.

Known numbers are computed, zeros and ones vanish, and both orders of a sum are one node. A
product with a known zero is zero: where XLA would carry a NaN through it, the NaN stays in the
factor that brought it. The sign of a zero is not kept where a known zero or an opposite
vanishes, nor by the larger of two zeros.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from kedge.compiler.graph import FLOATS, Graph, Node

COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
}
TYPES = {
    "f8": np.float64, "f4": np.float32, "i8": np.int64, "i4": np.int32, "i2": np.int16,
    "i1": np.int8, "u8": np.uint64, "u4": np.uint32, "u2": np.uint16, "u1": np.uint8,
    "b1": np.bool_,
}  # fmt: skip
FOLDED: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "and": lambda a, b: a & b,
    "or": lambda a, b: a | b,
    "xor": lambda a, b: a ^ b,
    "max": np.maximum,
    "min": np.minimum,
}


def value_of(node: Node) -> Any:
    """The number of a constant."""
    return node.param[1]


def is_number(node: Node, number: int) -> bool:
    """Whether a node is that constant."""
    return node.is_const and bool(node.param[1] == number)


class Algebra:
    """Operations on the nodes of one graph."""

    def __init__(self, graph: Graph):
        self.graph = graph

    def const(self, value: Any, kind: str) -> Node:
        """A known number of that kind; integers wrap."""
        if kind[0] not in "iu":
            return self.graph.const(TYPES[kind](value).item(), kind)
        info = np.iinfo(TYPES[kind])
        wrapped = (int(value) - int(info.min)) % 2**info.bits + int(info.min)
        return self.graph.const(wrapped, kind)

    def add(self, a: Node, b: Node) -> Node:
        """Sum; ``a + (-b)`` is the difference, and zeros go."""
        if a.is_const and b.is_const:
            return self._fold("add", a, b)
        if is_number(a, 0):
            return b
        if is_number(b, 0):
            return a
        if b.op == "neg":
            return self.sub(a, b.args[0])
        if a.op == "neg":
            return self.sub(b, a.args[0])
        return self._either("add", a, b)

    def sub(self, a: Node, b: Node) -> Node:
        """Difference."""
        if a.is_const and b.is_const:
            return self._fold("sub", a, b)
        if is_number(b, 0):
            return a
        if is_number(a, 0):
            return self.neg(b)
        if b.op == "neg":
            return self.add(a, b.args[0])
        return self.graph.make("sub", a.kind, (a, b))

    def mul(self, a: Node, b: Node) -> Node:
        """Product; signs are drawn out, so that they meet and go."""
        if a.is_const and b.is_const:
            return self._fold("mul", a, b)
        if b.is_const:
            a, b = b, a
        if is_number(a, 0):
            return a
        if is_number(a, 1):
            return b
        if is_number(a, -1):
            return self.neg(b)
        if a.op == "neg" and b.op == "neg":
            return self.mul(a.args[0], b.args[0])
        if a.kind in FLOATS and "neg" in (a.op, b.op):
            first, second = (x.args[0] if x.op == "neg" else x for x in (a, b))
            return self.neg(self.mul(first, second))
        return self._either("mul", a, b)

    def div(self, a: Node, b: Node) -> Node:
        """Quotient of floats."""
        if a.is_const and b.is_const:
            return self._fold("div", a, b)
        if is_number(b, 1) or is_number(a, 0):
            return a
        if a.op == "neg":
            return self.neg(self.div(a.args[0], b))
        return self.graph.make("div", a.kind, (a, b))

    def neg(self, a: Node) -> Node:
        """Opposite."""
        if a.is_const:
            return self.const(-value_of(a), a.kind)
        if a.op == "neg":
            return a.args[0]
        if a.op == "sub":
            return self.sub(a.args[1], a.args[0])
        return self.graph.make("neg", a.kind, (a,))

    def fma(self, a: Node, b: Node, c: Node) -> Node:
        """Product and sum with one rounding."""
        if a.is_const and b.is_const:
            return self.add(self.mul(a, b), c)
        return self.graph.make("fma", a.kind, (a, b, c))

    def compare(self, how: str, a: Node, b: Node) -> Node:
        """Whether one is less, equal..."""
        if a.is_const and b.is_const:
            return self.const(COMPARISONS[how](value_of(a), value_of(b)), "b1")
        if a is b and a.kind not in FLOATS:
            return self.const(how in ("le", "ge", "eq"), "b1")
        return self.graph.make(how, "b1", (a, b))

    def select(self, flag: Node, yes: Node, no: Node) -> Node:
        """One of two."""
        if flag.is_const:
            return yes if value_of(flag) else no
        if yes is no:
            return yes
        if flag.op == "not":
            return self.select(flag.args[0], no, yes)
        if yes.kind == "b1" and yes.is_const:
            return (
                self.both("or", flag, no)
                if value_of(yes)
                else self.both("and", self.invert(flag), no)
            )
        if no.kind == "b1" and no.is_const:
            return (
                self.both("or", self.invert(flag), yes)
                if value_of(no)
                else self.both("and", flag, yes)
            )
        return self.graph.make("select", yes.kind, (flag, yes, no))

    def both(self, how: str, a: Node, b: Node) -> Node:
        """Bitwise ``and``, ``or``, ``xor``."""
        if a.is_const and b.is_const:
            return self._fold(how, a, b)
        if a.kind == "b1" and (a.is_const or b.is_const):
            known, other = (a, b) if a.is_const else (b, a)
            if how == "xor":
                return self.invert(other) if value_of(known) else other
            return other if value_of(known) == (how == "and") else known
        if a is b and how != "xor":
            return a
        return self._either(how, a, b)

    def invert(self, a: Node) -> Node:
        """Logical or bitwise complement."""
        if a.is_const:
            known = value_of(a)
            return self.const(not known if a.kind == "b1" else ~known, a.kind)
        if a.op == "not":
            return a.args[0]
        return self.graph.make("not", a.kind, (a,))

    def convert(self, a: Node, kind: str) -> Node:
        """The same number as another kind of number."""
        if a.kind == kind:
            return a
        if a.is_const:
            value = value_of(a)
            if a.kind in FLOATS and kind[0] in "iu":  # the next integer that there is
                limits = np.iinfo(TYPES[kind])
                value = 0.0 if math.isnan(value) else value
                value = int(max(min(value, int(limits.max)), int(limits.min)))
            with np.errstate(all="ignore"):
                return self.const(value, kind)
        if kind == "b1":
            return self.compare("ne", a, self.const(0, a.kind))
        if a.kind == "b1" and kind in FLOATS:
            return self.select(a, self.const(1, kind), self.const(0, kind))
        return self.graph.make("convert", kind, (a,))

    def extreme(self, how: str, a: Node, b: Node) -> Node:
        """The larger (``max``) or smaller (``min``) of two; NaN if one is."""
        if a.is_const and b.is_const:
            return self._fold(how, a, b)
        if a is b:
            return a
        over = self.compare("gt" if how == "max" else "lt", a, b)
        if a.kind in FLOATS:
            over = self.both("or", over, self.compare("ne", a, a))
        return self.select(over, a, b)

    def clamp(self, low: Node, a: Node, high: Node) -> Node:
        """Between two limits."""
        return self.extreme("min", self.extreme("max", a, low), high)

    def absolute(self, a: Node) -> Node:
        """Without the sign."""
        if a.kind in FLOATS:
            return self.unary("abs", a)
        return self.select(self.compare("lt", a, self.const(0, a.kind)), self.neg(a), a)

    def unary(self, op: str, a: Node) -> Node:
        """Of one float: ``abs``, ``sqrt``, ``floor``..., known if the argument is."""
        if a.is_const:
            with np.errstate(all="ignore"):
                return self.const(_KNOWN[op](TYPES[a.kind](value_of(a))), a.kind)
        if op == "abs" and a.op in ("neg", "abs"):
            a = a.args[0]
        return self.graph.make(op, a.kind, (a,))

    def _either(self, op: str, a: Node, b: Node) -> Node:
        if a.key > b.key:
            a, b = b, a
        return self.graph.make(op, a.kind, (a, b))

    def _fold(self, op: str, a: Node, b: Node) -> Node:
        kind = TYPES[a.kind]
        with np.errstate(all="ignore"):
            return self.const(FOLDED[op](kind(value_of(a)), kind(value_of(b))), a.kind)


_KNOWN: dict[str, Callable[[Any], Any]] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "ceil": np.ceil,
    "trunc": np.trunc,
    "even": np.rint,
}
