"""Rules that pick numbers at places known only when the program runs."""

import math
from typing import Any

import numpy as np

from kedge.compiler.functions import Functions
from kedge.compiler.graph import FLOATS, Node, Unsupported
from kedge.compiler.interpret import Interpreter, rule, takes_any
from kedge.compiler.values import Opaque, Stored, Value, filled

MOST_CHOICES = 64
"""Places among which a number is chosen one by one."""


@rule("dynamic_slice")
@takes_any
def dynamic_slice(
    interpreter: Interpreter, equation: Any, source: Value, *starts: Value
) -> Value:
    """The part of an array that begins at ``starts``, moved inside if it would stick out."""
    if isinstance(source, Opaque) or any(isinstance(s, Opaque) for s in starts):
        return Opaque("slice of what is not known")
    f, sizes = interpreter.functions, equation.params["slice_sizes"]
    first = [f.convert(interpreter.nodes(s).item(), "i8") for s in starts]
    limits = extents(f, source)
    begin = [
        f.clamp(f.const(0, "i8"), s, f.sub(limit, f.const(size, "i8")))
        for s, limit, size in zip(first, limits, sizes, strict=True)
    ]
    picked = [at(f, source, begin, index) for index in np.ndindex(*sizes)]
    return filled(picked, tuple(sizes))


@rule("gather")
@takes_any
def gather(interpreter: Interpreter, equation: Any, source: Value, indices: Value) -> Value:
    """Slices of an array at several places, as ``lax.gather`` has it."""
    if isinstance(source, Opaque) or isinstance(indices, Opaque):
        return Opaque("gather of what is not known")
    f, where = interpreter.functions, interpreter.nodes(indices)
    numbers, sizes = equation.params["dimension_numbers"], equation.params["slice_sizes"]
    if numbers.operand_batching_dims:
        raise Unsupported("gather with batching dimensions")
    shape = equation.outvars[0].aval.shape
    inner = [a for a in range(len(sizes)) if a not in numbers.collapsed_slice_dims]
    outer = [a for a in range(len(shape)) if a not in numbers.offset_dims]
    fills = "fill" in str(equation.params["mode"]).lower()
    limits = extents(f, source)
    picked = []
    for place in np.ndindex(*shape):
        vector = where[tuple(place[a] for a in outer)]
        begin = [f.const(0, "i8")] * len(sizes)
        inside = f.const(True, "b1")
        for axis, start in zip(numbers.start_index_map, vector, strict=True):
            wanted = f.convert(start, "i8")
            last = f.sub(limits[axis], f.const(sizes[axis], "i8"))
            begin[axis] = f.clamp(f.const(0, "i8"), wanted, last)
            inside = f.both("and", inside, f.compare("eq", begin[axis], wanted))
        index = [0] * len(sizes)
        for axis, k in zip(inner, numbers.offset_dims, strict=True):
            index[axis] = place[k]
        number = at(f, source, begin, tuple(index))
        if fills:
            number = f.select(inside, number, _gap(f, equation, number))
        picked.append(number)
    return filled(picked, shape)


def _gap(f: Functions, equation: Any, like: Node) -> Node:
    value = equation.params["fill_value"]
    if value is None:
        if like.kind in FLOATS:
            value = math.nan
        elif like.kind == "b1":
            value = True
        else:
            least = -(2 ** (8 * int(like.kind[1:]) - 1))
            value = least if like.kind[0] == "i" else 2 ** (8 * int(like.kind[1:])) - 1
    return f.const(value, like.kind)


def extents(f: Functions, source: Value) -> list[Node]:
    """Sizes along each axis."""
    sizes = [f.const(size, "i8") for size in source.shape]
    if isinstance(source, Stored) and source.open_ended:
        sizes[0] = source.rows(f)
    return sizes


def at(f: Functions, source: Value, begin: list[Node], index: tuple[int, ...]) -> Node:
    """The number ``index`` places behind ``begin``, which lies inside."""
    if isinstance(source, Stored):
        offset, more = f.const(0, "i8"), 0
        for start, stride, i in zip(begin, source.strides, index, strict=True):
            offset = f.add(offset, f.mul(start, f.const(stride, "i8")))
            more += i * stride
        return source.load(f, offset, more)
    if all(start.is_const for start in begin):
        return source[tuple(s.param[1] + i for s, i in zip(begin, index, strict=True))]
    open_axes = [axis for axis, start in enumerate(begin) if not start.is_const]
    reach = [source.shape[axis] for axis in open_axes]
    if math.prod(reach) > MOST_CHOICES:
        raise Unsupported(f"a choice among {math.prod(reach)} numbers")
    choice = None
    for places in np.ndindex(*reach):
        place = [s.param[1] + i if s.is_const else i for s, i in zip(begin, index, strict=True)]
        here = f.const(True, "b1")
        for axis, value in zip(open_axes, places, strict=True):
            wanted = f.const(value - index[axis], "i8")
            here = f.both("and", here, f.compare("eq", begin[axis], wanted))
            place[axis] = value
        number = source[tuple(place)]
        choice = number if choice is None else f.select(here, number, choice)
    if choice is None:
        raise Unsupported("a number of an empty array")
    return choice


@rule("scatter", "scatter-add", "scatter-sub", "scatter-mul", "scatter-min", "scatter-max")
def _scatter(
    interpreter: Interpreter,
    equation: Any,
    source: np.ndarray,
    indices: np.ndarray,
    updates: np.ndarray,
) -> np.ndarray:
    """Windows written, or put together with what is there, at places that are known."""
    params = equation.params
    numbers, combine = params["dimension_numbers"], params["update_jaxpr"]
    if numbers.operand_batching_dims:
        raise Unsupported("scatter with batching dimensions")
    inner = [a for a in range(source.ndim) if a not in numbers.inserted_window_dims]
    outer = [a for a in range(updates.ndim) if a not in numbers.update_window_dims]
    window = [1] * source.ndim
    for axis, k in zip(inner, numbers.update_window_dims, strict=True):
        window[axis] = updates.shape[k]
    clips = "clip" in str(params["mode"]).lower()
    out = source.copy()
    for place in np.ndindex(*updates.shape):
        vector = indices[tuple(place[a] for a in outer)]
        if not all(v.is_const for v in vector):
            raise Unsupported("scatter at a place that is not known")
        begin = [0] * source.ndim
        for axis, start in zip(numbers.scatter_dims_to_operand_dims, vector, strict=True):
            begin[axis] = start.param[1]
        last = [n - m for n, m in zip(source.shape, window, strict=True)]
        inside = [min(max(b, 0), e) for b, e in zip(begin, last, strict=True)]
        if inside != begin and not clips:
            continue  # a window that sticks out is dropped whole
        index = inside
        for axis, k in zip(inner, numbers.update_window_dims, strict=True):
            index[axis] += place[k]
        target, new = tuple(index), updates[place]
        if combine is not None:
            pair: list[Any] = [out[target], new]
            values = [filled([node], ()) for node in pair]
            (result,) = interpreter.run(combine, params["update_consts"], values)
            new = interpreter.nodes(result).item()
        out[target] = new
    return out
