"""Rules of operations that only move numbers: nothing of them remains when the program runs."""

from typing import Any

import numpy as np

from kedge.compiler.interpret import Interpreter, rule
from kedge.compiler.values import filled, kind_of


@rule("reshape", "squeeze")
def _reshape(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    return a.reshape(equation.outvars[0].aval.shape)


@rule("broadcast_in_dim")
def _broadcast(interpreter: Interpreter, equation: Any, a: np.ndarray, *_: Any) -> np.ndarray:
    shape, places = equation.params["shape"], equation.params["broadcast_dimensions"]
    thin = [1] * len(shape)
    for axis, place in enumerate(places):
        thin[place] = a.shape[axis]
    return np.broadcast_to(a.reshape(thin), shape)


@rule("transpose")
def _transpose(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    return np.transpose(a, equation.params["permutation"])


@rule("rev")
def _reverse(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    return np.flip(a, equation.params["dimensions"])


@rule("slice")
def _slice(interpreter: Interpreter, equation: Any, a: np.ndarray) -> np.ndarray:
    begin, end = equation.params["start_indices"], equation.params["limit_indices"]
    steps = equation.params["strides"] or [1] * a.ndim
    return a[tuple(slice(*cut) for cut in zip(begin, end, steps, strict=True))]


@rule("concatenate")
def _concatenate(interpreter: Interpreter, equation: Any, *arrays: np.ndarray) -> np.ndarray:
    return np.concatenate(arrays, axis=equation.params["dimension"])


@rule("stack")
def _stack(interpreter: Interpreter, equation: Any, *arrays: np.ndarray) -> np.ndarray:
    return np.stack(arrays, axis=equation.params["axis"])


@rule("split")
def _split(interpreter: Interpreter, equation: Any, a: np.ndarray) -> list[np.ndarray]:
    places = np.cumsum(equation.params["sizes"])[:-1]
    return np.split(a, places, axis=equation.params["axis"])


@rule("pad")
def _pad(interpreter: Interpreter, equation: Any, a: np.ndarray, pad: np.ndarray) -> np.ndarray:
    shape = equation.outvars[0].aval.shape
    out = np.empty(shape, object)
    out.fill(pad.item())
    for index in np.ndindex(a.shape):
        config = zip(index, equation.params["padding_config"], strict=True)
        place = tuple(low + i * (inner + 1) for i, (low, _, inner) in config)
        if all(0 <= p < n for p, n in zip(place, shape, strict=True)):
            out[place] = a[index]
    return out


@rule("iota")
def _iota(interpreter: Interpreter, equation: Any, *_: Any) -> np.ndarray:
    shape, axis = equation.params["shape"], equation.params["dimension"]
    kind = kind_of(equation.params["dtype"])
    known = [interpreter.functions.const(i, kind) for i in range(shape[axis])]
    thin = [1] * len(shape)
    thin[axis] = shape[axis]
    return np.broadcast_to(filled(known, tuple(thin)), shape)


@rule("dynamic_update_slice")
def _update(
    interpreter: Interpreter, equation: Any, a: np.ndarray, new: np.ndarray, *at: np.ndarray
) -> np.ndarray:
    """Where the place is not known now, each number of it is chosen."""
    f, out = interpreter.functions, a.copy()
    starts = [
        f.clamp(f.const(0, s.item().kind), s.item(), f.const(n - m, s.item().kind))
        for s, n, m in zip(at, a.shape, new.shape, strict=True)
    ]
    for base in np.ndindex(*(n - m + 1 for n, m in zip(a.shape, new.shape, strict=True))):
        here = f.const(True, "b1")
        for s, b in zip(starts, base, strict=True):
            here = f.both("and", here, f.compare("eq", s, f.const(b, s.kind)))
        if here.is_const and not here.param[1]:
            continue
        for index in np.ndindex(new.shape):
            place = tuple(b + i for b, i in zip(base, index, strict=True))
            chosen: list[Any] = [new[index], out[place]]
            out[place] = f.select(here, *chosen)
    return out
