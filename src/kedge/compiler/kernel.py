"""A compiled program and the arrays that it works on."""

import functools as ft
import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from kedge.compiler.algebra import TYPES
from kedge.compiler.emit import HEAD, Writer
from kedge.compiler.machine import compile_text
from kedge.compiler.program import SHORT, Limits, Program

LANES = 4
"""Runs side by side: one register of AVX2 for each number.

With two, a step's numbers fill the registers sooner and go to memory and back; enough terms are
independent to keep both pipes busy.
"""


class Kernel:
    """One program as machine code, for one run or for several of one schedule."""

    def __init__(
        self,
        program: Program,
        batched: bool,
        limits: Limits = SHORT,
        pitch: int | None = None,
    ):
        self.lanes = LANES if batched else 1
        self.arguments = program.arguments
        self.outputs = [(o.kind, o.shape) for o in program.outputs]
        self.passed, self.places, self.ends = program.passed, program.places, program.ends
        self.carried = [node.kind for node in program.carried]
        self.code = compile_text(Writer(program, self.lanes, limits.lines, pitch).write())

    def fresh(self, events: int, runs: int) -> list[np.ndarray]:
        """Arrays for the results."""
        groups = -(-runs // self.lanes)
        return [
            _aligned((groups, events, *shape, self.lanes), TYPES[kind])
            for kind, shape in self.outputs
        ]

    def size(self, events: int) -> int:
        """Bytes of one run's results."""
        return events * sum(
            math.prod(shape) * np.dtype(TYPES[kind]).itemsize for kind, shape in self.outputs
        )

    def carry(self, runs: int) -> np.ndarray:
        """Room for what is carried from event to event, as 64-bit words."""
        return np.zeros((runs, len(self.carried)), np.int64)

    def block(
        self,
        arrays: Sequence[np.ndarray | None],
        outputs: Sequence[np.ndarray],
        carry: np.ndarray,
        events: int,
        begin: int,
        end: int,
        anew: bool = True,
    ) -> np.ndarray:
        """The words that the code is called with; the arrays must outlive the call."""
        words = [events, begin, end, int(anew), carry.ctypes.data]
        for array, argument in zip(arrays, self.arguments, strict=True):
            if array is None:
                words += [0, 0, 0]
                continue
            per_run = self.lanes > 1 and argument.per_run
            shape = array.shape[1:] if per_run else array.shape
            rows = shape[0] if shape else 1
            words += [array.ctypes.data, int(np.prod(shape, dtype=int)), rows]
        words += [array.ctypes.data for array in outputs]
        if len(words) != HEAD + 3 * len(self.arguments) + len(self.outputs):
            raise AssertionError("a block of the wrong length")
        return np.array(words, np.int64)

    def run(
        self,
        arrays: Sequence[np.ndarray | None],
        outputs: Sequence[np.ndarray],
        events: int,
        runs: int = 1,
    ) -> None:
        """The whole pass over ``events`` of all runs, written into ``outputs``.

        The cores share the runs, in whole registers: each run's bits are its own.
        """
        carry = self.carry(runs)
        share = -(-runs // (cores() * self.lanes)) * self.lanes
        blocks = [
            self.block(arrays, outputs, carry, events, begin, min(begin + share, runs))
            for begin in range(0, runs, share)
        ]
        if len(blocks) == 1:
            self.code.call(blocks[0].ctypes.data)
            return
        calls = [_threads().submit(self.code.call, block.ctypes.data) for block in blocks]
        for call in calls:
            call.result()


@ft.cache
def _threads() -> ThreadPoolExecutor:
    """Kept, since starting a thread takes as long as many a pass; anew in a forked process."""
    if hasattr(os, "register_at_fork"):  # where processes can fork
        os.register_at_fork(after_in_child=_threads.cache_clear)
    return ThreadPoolExecutor(cores(), "kedge-native")


def cores() -> int:
    """How many threads may run at once."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


def prepared(array: Any, kind: str) -> np.ndarray:
    """An array as the code reads it: without a copy where it is that already."""
    return np.ascontiguousarray(array, TYPES[kind])


def _aligned(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Uninitialised numbers, at a place from which JAX takes them without a copy."""
    size = int(np.prod(shape, dtype=int)) * np.dtype(dtype).itemsize
    raw = np.empty(size + 64, np.uint8)
    begin = -raw.ctypes.data % 64
    return raw[begin : begin + size].view(dtype).reshape(shape)
