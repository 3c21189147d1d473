"""Rules of sums, products of matrices, and factorisations: unrolled to their scalars."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from kedge.compiler.algebra import Algebra
from kedge.compiler.elementwise import each
from kedge.compiler.functions import Functions
from kedge.compiler.graph import Node, Unsupported
from kedge.compiler.interpret import Interpreter, rule
from kedge.compiler.values import filled, kind_of

Fold = Callable[[Functions], Callable[[Node, Node], Node]]
FOLDS: dict[str, Fold] = {
    "sum": lambda f: f.add,
    "prod": lambda f: f.mul,
    "max": lambda f: lambda a, b: f.extreme("max", a, b),
    "min": lambda f: lambda a, b: f.extreme("min", a, b),
    "and": lambda f: lambda a, b: f.both("and", a, b),
    "or": lambda f: lambda a, b: f.both("or", a, b),
    "xor": lambda f: lambda a, b: f.both("xor", a, b),
}
EMPTY = {"sum": 0, "prod": 1, "and": -1, "or": 0, "xor": 0}


@rule(*(f"reduce_{name}" for name in FOLDS))
def _reduce(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    f, name = interpreter.functions, equation.primitive.name.removeprefix("reduce_")
    axes = equation.params["axes"]
    kept = [axis for axis in range(a.ndim) if axis not in axes]
    shape = tuple(a.shape[axis] for axis in kept)
    sizes = [int(np.prod([a.shape[i] for i in part], dtype=int)) for part in (kept, axes)]
    rows = np.transpose(a, [*kept, *axes]).reshape(sizes)
    combine, results = FOLDS[name](f), []
    for row in rows:
        if len(row) == 0:
            if name not in EMPTY:
                raise Unsupported("the extreme of nothing")
            results.append(f.const(EMPTY[name], kind_of(equation.outvars[0].aval.dtype)))
            continue
        value = row[0]
        for other in row[1:]:
            value = combine(value, other)
        results.append(value)
    return filled(results, shape)


@rule(*(f"cum{name}" for name in ("sum", "prod", "max", "min")))
def _cumulate(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    combine = FOLDS[equation.primitive.name.removeprefix("cum")](interpreter.functions)
    axis, reverse = equation.params["axis"], equation.params["reverse"]
    out = np.moveaxis(a.copy(), axis, 0)
    places = range(len(out))
    for last, place in itertools.pairwise(places):
        i, j = (len(out) - 1 - last, len(out) - 1 - place) if reverse else (last, place)
        for others in np.ndindex(out.shape[1:]):
            out[(j, *others)] = combine(out[(i, *others)], out[(j, *others)])
    return np.moveaxis(out, 0, axis)


@rule("argmax", "argmin")
def _argument(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    f, (axis,) = interpreter.functions, equation.params["axes"]
    how = "gt" if equation.primitive.name == "argmax" else "lt"
    kind = np.dtype(equation.params["index_dtype"])
    name = f"{kind.kind}{kind.itemsize}"
    last = np.moveaxis(a, axis, -1)
    results = []
    for row in last.reshape(-1, last.shape[-1]):
        best, place = row[0], f.const(0, name)
        for i, value in enumerate(row[1:], 1):
            # The first NaN counts as the extreme, as in XLA.
            better = f.both(
                "and",
                f.both("or", f.compare(how, value, best), f.compare("ne", value, value)),
                f.compare("eq", best, best),
            )
            best = f.select(better, value, best)
            place = f.select(better, f.const(i, name), place)
        results.append(place)
    return filled(results, last.shape[:-1])


@rule("dot_general")
def _dot(interpreter: Interpreter, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    f = interpreter.functions
    (summed_a, summed_b), (batch_a, batch_b) = equation.params["dimension_numbers"]

    def arranged(x: np.ndarray, batch: Any, summed: Any) -> np.ndarray:
        free = [axis for axis in range(x.ndim) if axis not in (*batch, *summed)]
        size = [
            int(np.prod([x.shape[i] for i in part], dtype=int))
            for part in (batch, free, summed)
        ]
        return np.transpose(x, [*batch, *free, *summed]).reshape(size)

    kind = kind_of(equation.outvars[0].aval.dtype)
    a, b = (each(lambda x: f.convert(x, kind), array) for array in (a, b))
    first, second = arranged(a, batch_a, summed_a), arranged(b, batch_b, summed_b)
    if first.shape[-1] == 0:
        zero = f.const(0, kind)
        shape = equation.outvars[0].aval.shape
        return filled([zero] * int(np.prod(shape, dtype=int)), shape)
    results = [
        inner(f, row, column)
        for rows, columns in zip(first, second, strict=True)
        for row in rows
        for column in columns
    ]
    return filled(results, equation.outvars[0].aval.shape)


def inner(f: Algebra, a: np.ndarray, b: np.ndarray) -> Node:
    """Sum of products, of which there is one at least."""
    value = f.mul(a[0], b[0])
    for x, y in zip(a[1:], b[1:], strict=True):
        value = f.add(value, f.mul(x, y))
    return value


@rule("cholesky")
def _cholesky(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    f = interpreter.functions
    out = np.empty(a.shape, object)
    for batch in np.ndindex(a.shape[:-2]):
        matrix, root = a[batch], out[batch]
        root.fill(f.const(0, matrix.flat[0].kind))
        for j in range(len(matrix)):
            value = matrix[j, j]
            for k in range(j):
                value = f.sub(value, f.mul(root[j, k], root[j, k]))
            root[j, j] = f.unary("sqrt", value)
            inverse = f.div(f.const(1, value.kind), root[j, j])
            for i in range(j + 1, len(matrix)):
                value = matrix[i, j]
                for k in range(j):
                    value = f.sub(value, f.mul(root[i, k], root[j, k]))
                root[i, j] = f.mul(value, inverse)
    return _nan_if_any(f, out)


def _nan_if_any(f: Functions, roots: np.ndarray) -> np.ndarray:
    """XLA's factor is NaN throughout where the matrix is not positive definite."""
    size, out = roots.shape[-1], roots.copy()
    for batch in np.ndindex(roots.shape[:-2]):
        good = f.const(True, "b1")
        for j in range(size):
            pivot = roots[(*batch, j, j)]
            positive = f.compare("gt", pivot, f.const(0, pivot.kind))
            good = f.both("and", good, positive)
        for i in range(size):
            for j in range(i + 1):
                value = roots[(*batch, i, j)]
                nan = f.const(float("nan"), value.kind)
                out[(*batch, i, j)] = f.select(good, value, nan)
    return out


@rule("triangular_solve")
def _triangular(
    interpreter: Interpreter, equation: Any, a: np.ndarray, b: np.ndarray
) -> np.ndarray:
    f, params = interpreter.functions, equation.params
    if params["conjugate_a"] or params["unit_diagonal"]:
        raise Unsupported("triangular_solve of another form")
    out = np.empty(b.shape, object)
    for batch in np.ndindex(a.shape[:-2]):
        matrix, right = a[batch], b[batch]
        lower = params["lower"]
        if params["transpose_a"]:
            matrix, lower = matrix.T, not lower
        if not params["left_side"]:  # x a = b is a' x' = b'
            matrix, right, lower = matrix.T, right.T, not lower
        solution = _substitute(f, matrix, right, lower)
        out[batch] = solution if params["left_side"] else solution.T
    return out


def _substitute(f: Functions, a: np.ndarray, b: np.ndarray, lower: bool) -> np.ndarray:
    size, out = len(a), b.copy()
    order = list(range(size)) if lower else list(reversed(range(size)))
    for place, i in enumerate(order):
        for column in range(b.shape[1]):
            value = b[i, column]
            for k in order[:place]:
                value = f.sub(value, f.mul(a[i, k], out[k, column]))
            out[i, column] = f.div(value, a[i, i])
    return out
