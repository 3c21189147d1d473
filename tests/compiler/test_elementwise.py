"""Each operation element by element, for each kind of number it takes, on edge values."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from fixtures.machine_code import assert_both, by_equations, by_machine, primitives
from kedge.compiler.algebra import TYPES, value_of
from kedge.compiler.functions import Functions
from kedge.compiler.graph import Graph

pytest.importorskip("llvmlite")
FLOAT = "f8", "f4"
SIGNED = "i8", "i4", "i2", "i1"
INTEGER = *SIGNED, "u8", "u4", "u2", "u1"
NUMBER = *FLOAT, *INTEGER
ALL = *NUMBER, "b1"

EXACT = {
    "add": (lax.add, "xx", NUMBER),
    "sub": (lax.sub, "xx", NUMBER),
    "mul": (lax.mul, "xx", NUMBER),
    "div": (lax.div, "xx", FLOAT),
    "rem": (lax.rem, "xx", FLOAT),
    "max": (lax.max, "xx", ALL),
    "min": (lax.min, "xx", ALL),
    "and": (lax.bitwise_and, "xx", (*INTEGER, "b1")),
    "or": (lax.bitwise_or, "xx", (*INTEGER, "b1")),
    "xor": (lax.bitwise_xor, "xx", (*INTEGER, "b1")),
    "not": (lax.bitwise_not, "x", (*INTEGER, "b1")),
    "shift_left": (lax.shift_left, "xx", INTEGER),
    "shift_right_logical": (lax.shift_right_logical, "xx", INTEGER),
    "shift_right_arithmetic": (lax.shift_right_arithmetic, "xx", INTEGER),
    **{name: (getattr(lax, name), "xx", ALL) for name in ("eq", "ne", "lt", "le", "gt", "ge")},
    "neg": (lax.neg, "x", NUMBER),
    "sign": (lax.sign, "x", NUMBER),
    "abs": (lax.abs, "x", (*FLOAT, *SIGNED)),
    "square": (lax.square, "x", NUMBER),
    "sqrt": (lax.sqrt, "x", FLOAT),
    "floor": (lax.floor, "x", FLOAT),
    "ceil": (lax.ceil, "x", FLOAT),
    "round": (
        lambda x: [lax.round(x, how) for how in lax.RoundingMethod], "x", FLOAT,
    ),
    "is_finite": (lax.is_finite, "x", FLOAT),
    "clamp": (lax.clamp, "xxx", NUMBER),
    "select_n": (lax.select, "bxx", ALL),
    "stop_gradient": (lax.stop_gradient, "x", ALL),
    "copy": (lambda x: jnp.array(x, copy=True), "x", ALL),
    "optimization_barrier": (lax.optimization_barrier, "x", ALL),
    "add_any": (lambda x: jax.vjp(lambda y: y * y, x)[1](x), "x", FLOAT),
    "integer_pow": (lambda x: [lax.integer_pow(x, n) for n in (0, 1, 2)], "x", FLOAT),
}  # fmt: skip
"""Operation: how it is called, its arguments (x: a number, b: a flag), and of which kinds."""


def edges(kind):
    """Values at which an operation may do something else than usual, and a few usual ones."""
    dtype = np.dtype(TYPES[kind])
    if kind == "b1":
        return np.array([False, True])
    rng = np.random.default_rng(7)
    if kind[0] == "f":
        info = np.finfo(dtype)
        special = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 1.5, 2.5, -2.5, 7.0, info.max, info.min,
                   info.tiny, -info.tiny, info.eps, np.inf, -np.inf, np.nan]  # fmt: skip
        return np.array([*special, *rng.normal(0, 10, 4)], dtype)
    info = np.iinfo(dtype)
    special = [0, 1, 2, 3, info.max, info.max - 1, info.min, info.min + 1]
    special += [-1, -2] if kind[0] == "i" else []
    drawn = rng.integers(info.min, info.max, 3, dtype, endpoint=True)
    return np.array([*special, 8 * dtype.itemsize, *drawn], dtype)


def combinations(pattern, kind):
    """Arguments for a pattern: all pairs of edge values; of three, every seventh."""
    values = [edges("b1" if letter == "b" else kind) for letter in pattern]
    rows = list(itertools.product(*values))[:: 7 if len(pattern) > 2 else 1]
    return [np.array(column, v.dtype) for column, v in zip(zip(*rows, strict=True), values,
                                                           strict=True)]  # fmt: skip


@pytest.mark.parametrize("name", EXACT)
def test_exact(name):
    """All kinds of numbers in one program."""
    function, pattern, kinds = EXACT[name]
    sets = [combinations(pattern, kind) for kind in kinds]
    length = max(len(columns[0]) for columns in sets)
    rows = [np.resize(column, length) for columns in sets for column in columns]

    def whole(*values):
        step = len(pattern)
        return [function(*values[i : i + step]) for i in range(0, len(values), step)]

    assert name in primitives(jax.make_jaxpr(whole)(*[row[0] for row in rows]).jaxpr)
    signs = name not in ("max", "min", "clamp")  # of two zeros either is the larger
    assert_both(whole, *rows, elementwise=True, signs=signs)


@pytest.mark.parametrize("before", ALL)
def test_convert_element_type(before):
    def function(x):
        return [lax.convert_element_type(x, TYPES[after]) for after in ALL if after != before]

    assert_both(function, edges(before), elementwise=True)


@pytest.mark.parametrize("kinds", ["f8 i8", "f4 i4", "i8 f8", "u4 f4", "u2 i2", "i1 u1"])
def test_bitcast_convert_type(kinds):
    before, after = kinds.split()
    assert_both(
        lambda x: lax.bitcast_convert_type(x, TYPES[after]), edges(before), elementwise=True
    )


@pytest.mark.parametrize("kind", INTEGER)
def test_div_and_rem_of_integers_by_what_is_known(kind):
    divisors = [1, 2, 3, 7, 100, *([-3, -128] if kind[0] == "i" else [])]

    def function(x):
        known = [np.array(divisor, TYPES[kind]) for divisor in divisors]
        return [operation(x, by) for by in known for operation in (lax.div, lax.rem)]

    assert_both(function, edges(kind))


@pytest.mark.parametrize("kind", ["f8", "i8", "b1"])
def test_select_n_among_many(kind):
    which = np.array([0, 1, 2, 2, 1, 0], np.int32)
    values = np.array([0, 1, 2, 3, 4, 5]).astype(TYPES[kind])
    assert_both(lax.select_n, which, values, values[::-1].copy(), values * values)


@pytest.mark.parametrize("kind", FLOAT)
@pytest.mark.parametrize("power", [-3, -1, 3, 5, 8])
def test_integer_pow(kind, power):
    """Each of a few products rounds once."""
    assert_both(lambda x: lax.integer_pow(x, power), edges(kind), ulp=4, elementwise=True)


@pytest.mark.parametrize("kind", ["i8", "u2"])
def test_known_operands_are_computed_as_the_machine_does(kind):
    """What is folded beside what is computed, at the edges: wrapping, signs, shifts."""

    def function(numbers, three):
        out = []
        for a, b in itertools.permutations(numbers, 2):
            out += [a + b, a - b, a * b, a & b, a | b, a ^ b, -a, ~a, lax.max(a, b), a < b]
            out += [lax.div(a, three), lax.rem(a, three), lax.sign(a), lax.square(a), abs(a)]
            out += [lax.max(-a, b), ~a < b, -a <= b, lax.square(a) > b]
            out += [lax.shift_left(a, three), lax.shift_right_logical(a, b)]
            out += [lax.convert_element_type(a, t) for t in ("float64", "int8", "uint64")]
        return out

    info = np.iinfo(TYPES[kind])
    numbers = [TYPES[kind](v) for v in (info.min, info.max - 2, 3)]
    three = lax.full((), numbers[-1])
    known = by_machine(
        lambda x: [*function([lax.full((), v) for v in numbers], three), x], np.zeros(1)
    )
    given = by_machine(lambda *xs: function(xs, three), *[np.array([v]) for v in numbers])
    for folded, computed in zip(known, given, strict=False):
        np.testing.assert_array_equal(folded, computed)


@pytest.mark.parametrize("kind", INTEGER)
def test_floats_that_are_known_become_the_next_integers(kind):
    f = Functions(Graph(100))
    values = np.array([np.inf, -np.inf, np.nan, 1e300, -1e300, -1.7, 255.5, 3.99e9])
    folded = [value_of(f.convert(f.const(value, "f8"), kind)) for value in values]
    (expected,) = by_equations(lambda x: [lax.convert_element_type(x, TYPES[kind])], values)
    np.testing.assert_array_equal(folded, expected)


def test_zeros_that_are_known_vanish():
    """Where it departs from XLA, as :mod:`kedge.compiler.algebra` says: with a known zero a
    product is zero, whatever the other factor is; and zeros may come with the other sign."""
    x = np.array([np.nan, np.inf, -0.0])
    product, difference, total = by_machine(lambda x: [0.0 * x, 0.0 - x, 0.0 + x], x)
    np.testing.assert_array_equal(product, np.zeros(3))
    np.testing.assert_array_equal(difference, -x)
    np.testing.assert_array_equal(total, x)
