"""Graphs of scalars in which equal terms are one node, with real branches where they can be."""

from collections.abc import Callable, Sequence
from typing import Any

from kedge.core.errors import KedgeError

FLOATS = "f8", "f4"
SIGNED = "i8", "i4", "i2", "i1"
KINDS = (*FLOATS, *SIGNED, "u8", "u4", "u2", "u1", "b1")


class Unsupported(KedgeError):
    """A program that cannot be compiled this way: the caller lets XLA have it."""


class Node:
    """One scalar, the same for all runs or, if ``varying``, one for each."""

    __slots__ = ("args", "depth", "key", "kind", "op", "param", "varying")

    def __init__(
        self,
        op: str,
        kind: str,
        args: tuple["Node", ...],
        param: Any,
        varying: bool,
        depth: int,
    ):
        self.op, self.kind, self.args, self.param = op, kind, args, param
        self.varying, self.depth, self.key = varying, depth, 0

    @property
    def is_const(self) -> bool:
        return self.op == "const"


class Branches:
    """What one real branch computes: for each case its nodes and its results."""

    def __init__(self, index: Node):
        self.index = index
        self.cases: list[tuple[Region, list[Node | None]]] = []
        self.results: list[Node] = []


class Region:
    """Nodes in the order in which they are computed; those around it can be used inside."""

    def __init__(self, outer: "Region | None"):
        self.outer = outer
        self.depth = 0 if outer is None else outer.depth + 1
        self.items: list[Node | Branches] = []
        self.table: dict[Any, Node] = {}


class Graph:
    """Builds nodes; ``make`` gives the node there is, if it has been computed before.

    Region 0 is done once for each pass, region 1 at each event, deeper ones inside branches.
    What depends on nothing but region 0 is computed there, wherever it is asked for.
    """

    def __init__(self, most: int):
        self.root = self.here = Region(None)
        self.count, self.most = 0, most

    def const(self, value: Any, kind: str) -> Node:
        """A number that is known now."""
        # repr, since 0.0 and -0.0 are equal, and a NaN is not.
        return self._node("const", kind, (), (repr(value), value), False)

    def make(
        self,
        op: str,
        kind: str,
        args: Sequence[Node] = (),
        param: Any = None,
        per_run: bool = False,
    ) -> Node:
        """A node that varies with the run if ``per_run`` or if one of its arguments does."""
        varying = per_run or any(arg.varying for arg in args)
        return self._node(op, kind, tuple(args), param, varying)

    def branch(
        self, index: Node, cases: Sequence[Callable[[], Sequence[Node | None]]]
    ) -> list[Node | None]:
        """Results of the case that ``index`` says; the others are not computed.

        The index must be the same for all runs and within the number of cases. What one case
        cannot tell (None) is not known of the whole.
        """
        branches = Branches(index)
        outer = self.here
        for case in cases:
            self.here = Region(outer)
            branches.cases.append((self.here, list(case())))
        self.here = outer
        outer.items.append(branches)
        columns = zip(*(values for _, values in branches.cases), strict=True)
        return [self._merged(branches, place, values) for place, values in enumerate(columns)]

    def _merged(
        self, branches: Branches, place: int, values: tuple[Node | None, ...]
    ) -> Node | None:
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        if all(value is known[0] for value in known):
            return known[0]
        varying = any(value.varying for value in known)
        depth = self.here.depth
        node = Node("result", known[0].kind, (), (branches, place), varying, depth)
        self._count(node)
        branches.results.append(node)
        return node

    def loop(self) -> Region:
        """Enter the region of the events."""
        self.here = Region(self.root)
        return self.here

    def _node(
        self, op: str, kind: str, args: tuple[Node, ...], param: Any, varying: bool
    ) -> Node:
        shown = param[0] if op == "const" else param
        key = (op, kind, shown, *[arg.key for arg in args])
        region: Region | None = self.here
        while region is not None:
            known = region.table.get(key)
            if known is not None:
                return known
            region = region.outer
        depth = max((arg.depth for arg in args), default=1 if op in PER_EVENT else 0)
        place = self.root if depth == 0 else self.here
        node = Node(op, kind, args, param, varying, place.depth)
        self._count(node)
        place.table[key] = node
        place.items.append(node)
        return node

    def _count(self, node: Node) -> None:
        self.count += 1
        node.key = self.count
        if self.count > self.most:
            raise Unsupported(f"more than {self.most} scalars")


PER_EVENT = "event", "carry"
"""Nodes without arguments that change from event to event."""
