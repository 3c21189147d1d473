"""A traced pass as a graph: what is done once, what at each event, what comes out."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from kedge.compiler import calling, elementwise, indexing, reducing, shaping
from kedge.compiler.functions import Functions
from kedge.compiler.graph import Graph, Node, Region, Unsupported
from kedge.compiler.interpret import Interpreter
from kedge.compiler.values import Opaque, Stored, Value, filled, kind_of, literal


class Limits(NamedTuple):
    """How long a program may become before it is left to XLA."""

    scalars: int = 60_000
    """While it is taken apart."""
    lines: int = 26_000
    """LLVM's time grows faster than a program's length: from here on XLA compiles sooner."""


SHORT = Limits()


RULES_OF = calling, elementwise, indexing, reducing, shaping
"""The modules whose import registers the rules."""


class Argument(NamedTuple):
    """One array that the program reads."""

    kind: str
    shape: tuple[int, ...]
    per_run: bool
    """Whether each run has its own."""
    open_ended: bool
    """Whether the number of rows is known only when the program runs."""
    pitch: int | None = None
    """Numbers from row to row, where they do not follow each other without a gap."""


class Output(NamedTuple):
    """One array that it writes, with a row for each event."""

    kind: str
    nodes: list[Node]
    shape: tuple[int, ...]
    """Of a row."""


class Program(NamedTuple):
    """All that is needed to write it down for the machine."""

    arguments: list[Argument]
    once: Region
    loop: Region
    start: list[Node]
    """What is carried into the first event."""
    carried: list[Node]
    """What is carried into each event, as the loop knows it."""
    leaving: list[Node]
    """What each event leaves to the next."""
    outputs: list[Output]
    passed: dict[int, int]
    """Results that are arguments as they came: number of the result to that of the argument."""
    places: list[int]
    """Numbers of the other results, in the order of ``outputs``."""
    ends: dict[int, slice]
    """Results that are what the last event leaves: number of the result to its part of what is
    carried. What no event changes is not carried, and no result."""


def build(
    traced: ClosedJaxpr,
    arguments: Sequence[Argument | None],
    batched: bool,
    limits: Limits = SHORT,
) -> Program:
    """Take a program apart that ends in one loop over events.

    An argument that is None must not be needed: a random key. ``batched`` programs are for
    several runs at once.

    Raises:
        Unsupported: it has another form, or does what cannot be compiled.
    """
    graph = Graph(limits.scalars)
    functions = Functions(graph)
    interpreter = Interpreter(functions)
    jaxpr = traced.jaxpr
    known: dict[Any, Value] = {}
    for variable, const in zip(jaxpr.constvars, traced.consts, strict=True):
        known[variable] = interpreter.constant(const)
    for number, (variable, argument) in enumerate(zip(jaxpr.invars, arguments, strict=True)):
        known[variable] = (
            Opaque("a random key")
            if argument is None
            else Stored(
                number, argument.kind, argument.shape, batched and argument.per_run,
                argument.open_ended, pitch=argument.pitch,
            )
        )  # fmt: skip
    loops = [e for e in jaxpr.eqns if e.primitive.name == "scan"]
    if not loops or loops[-1] is not jaxpr.eqns[-1]:
        raise Unsupported("a program that does not end in its loop")

    def read(atom: Any) -> Value:
        return literal(functions, atom) if isinstance(atom, Literal) else known[atom]

    for equation in jaxpr.eqns[:-1]:
        results = interpreter.compute(equation, [read(atom) for atom in equation.invars])
        known.update(zip(equation.outvars, results, strict=True))
    loop = loops[-1]
    return _loop(
        interpreter, loop, [read(a) for a in loop.invars], jaxpr, list(arguments), batched
    )


def _loop(
    interpreter: Interpreter,
    loop: Any,
    values: list[Value],
    jaxpr: Any,
    arguments: list[Argument | None],
    batched: bool,
) -> Program:
    functions, graph = interpreter.functions, interpreter.functions.graph
    params = loop.params
    if params["reverse"]:
        raise Unsupported("a loop backwards")
    fixed, count = params["num_consts"], params["num_carry"]
    inside = params["jaxpr"].jaxpr
    consts = values[:fixed]
    start = [interpreter.nodes(v) for v in values[fixed : fixed + count]]
    inputs = values[fixed + count :]
    if any(not isinstance(v, Stored) for v in inputs):
        raise Unsupported("a loop over what is computed")
    per_run = _varying(inside, consts, start, inputs) if batched else [False] * count
    once, body = graph.root, graph.loop()
    carried: list[Node] = []
    symbols, parts = [], []
    for array, differs in zip(start, per_run, strict=True):
        nodes = []
        for first in array.flat:
            node = graph.make("carry", first.kind, (), len(carried), differs)
            nodes.append(node)
            carried.append(node)
        symbols.append(filled(nodes, array.shape))
        parts.append(slice(len(carried) - array.size, len(carried)))
    event = graph.make("event", "i8")
    rows = [v.row(functions, event) for v in inputs]
    consts_of = params["jaxpr"].consts
    values_after = interpreter.run(inside, consts_of, [*consts, *symbols, *rows])
    leaving = [n for v in values_after[:count] for n in interpreter.nodes(v).flat]
    results = {v: number for number, v in enumerate(loop.outvars)}
    numbers = {v: number for number, v in enumerate(jaxpr.invars)}
    outputs, passed, places, ends = [], {}, [], {}
    for place, atom in enumerate(jaxpr.outvars):
        if isinstance(atom, Literal):
            continue
        if atom in numbers:
            passed[place] = numbers[atom]
            continue
        if atom not in results:
            continue
        if results[atom] < count:
            ends[place] = parts[results[atom]]
            continue
        array = interpreter.nodes(values_after[results[atom]])
        kind = kind_of(loop.outvars[results[atom]].aval.dtype)
        outputs.append(Output(kind, list(array.flat), array.shape))
        places.append(place)
    given = [a if a is not None else Argument("f8", (), False, False) for a in arguments]
    first = [n for array in start for n in array.flat]
    return Program(given, once, body, first, carried, leaving, outputs, passed, places, ends)


def _varying(
    jaxpr: Any, consts: list[Value], start: list[np.ndarray], inputs: list[Value]
) -> list[bool]:
    """Which carried arrays differ from run to run: those that something reaches that does."""

    def differs(value: Value) -> bool:
        if isinstance(value, np.ndarray):
            return any(node.varying for node in value.flat)
        return isinstance(value, Stored) and value.per_run

    carry = [differs(array) for array in start]
    fixed, rows = [differs(v) for v in consts], [differs(v) for v in inputs]
    while True:
        flags = dict(zip(jaxpr.invars, [*fixed, *carry, *rows], strict=True))
        for equation in jaxpr.eqns:
            reached = any(
                flags.get(a, False) for a in equation.invars if not isinstance(a, Literal)
            )
            flags.update(dict.fromkeys(equation.outvars, reached))
        after = [
            before or (not isinstance(atom, Literal) and flags.get(atom, False))
            for before, atom in zip(carry, jaxpr.outvars, strict=False)
        ]
        if after == carry:
            return carry
        carry = after
