"""What a traced variable stands for: an array of nodes, or numbers in memory."""

from typing import Any

import numpy as np
from jax.extend.core import Literal

from kedge.compiler.algebra import TYPES
from kedge.compiler.functions import Functions
from kedge.compiler.graph import Node, Unsupported

MOST_ELEMENTS = 4096
"""Of an array that is taken apart."""


class Stored:
    """Numbers in memory: an argument of the program, or the part of it from ``offset`` on.

    ``open_ended`` says that the number of rows is known only when the program runs.
    """

    def __init__(
        self,
        number: int,
        kind: str,
        shape: tuple[int, ...],
        per_run: bool,
        open_ended: bool,
        offset: Node | None = None,
        pitch: int | None = None,
    ):
        self.number, self.kind, self.shape, self.per_run = number, kind, shape, per_run
        self.open_ended, self.offset, self.pitch = open_ended, offset, pitch

    @property
    def strides(self) -> list[int]:
        """How many numbers lie between neighbours along each axis."""
        strides = [int(np.prod(self.shape[i + 1 :], dtype=int)) for i in range(len(self.shape))]
        return strides if self.pitch is None else [self.pitch, *strides[1:]]

    def load(self, functions: Functions, index: Node, more: int = 0) -> Node:
        """The number ``more`` behind ``index``."""
        if self.offset is not None:
            index = functions.add(index, self.offset)
        per_run = self.per_run
        return functions.graph.make("load", self.kind, (index,), (self.number, more), per_run)

    def row(self, functions: Functions, index: Node) -> "Stored":
        """What stands at ``index`` along the first axis."""
        offset = functions.mul(index, functions.const(self.strides[0], "i8"))
        if self.offset is not None:
            offset = functions.add(offset, self.offset)
        return Stored(self.number, self.kind, self.shape[1:], self.per_run, False, offset)

    def rows(self, functions: Functions) -> Node:
        """How many rows there are."""
        if self.open_ended:
            return functions.graph.make("rows", "i8", (), self.number)
        return functions.const(self.shape[0], "i8")

    def nodes(self, functions: Functions) -> np.ndarray:
        """All of it, number by number."""
        size = int(np.prod(self.shape, dtype=int))
        if self.open_ended or size > MOST_ELEMENTS:
            raise Unsupported(f"the whole of an array of shape {self.shape}")
        zero = functions.const(0, "i8")
        return filled([self.load(functions, zero, i) for i in range(size)], self.shape)


class Opaque:
    """A value nobody may look at, such as a random key: an error only if it is needed."""

    def __init__(self, why: str):
        self.why = why


Value = Any  # np.ndarray of nodes, Stored or Opaque


def filled(nodes: list[Node], shape: tuple[int, ...]) -> np.ndarray:
    """An array of nodes from its elements in order."""
    array = np.empty(len(nodes), object)
    array[:] = nodes
    return array.reshape(shape)


def kind_of(dtype: Any) -> str:
    """Short name of a type of numbers."""
    try:
        numpy_type = np.dtype(dtype)
    except TypeError:
        raise Unsupported(f"values of type {dtype}") from None
    if numpy_type == np.bool_:
        return "b1"
    name = f"{numpy_type.kind}{numpy_type.itemsize}"
    if name not in TYPES:
        raise Unsupported(f"values of type {dtype}")
    return name


def constants(functions: Functions, value: Any) -> np.ndarray:
    """An array that is known."""
    array = np.asarray(value)
    if array.size > MOST_ELEMENTS:
        raise Unsupported(f"a constant of shape {array.shape}")
    kind = kind_of(array.dtype)
    return filled([functions.const(v, kind) for v in array.ravel()], array.shape)


def literal(functions: Functions, atom: Literal) -> np.ndarray:
    """A constant in the program's text."""
    kind: Any = atom.aval
    return constants(functions, np.asarray(atom.val, kind.dtype))
