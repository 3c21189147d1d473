"""How events and answers of one rig lie in memory: rows that machine code reads and writes."""

import math
from typing import Any, NamedTuple

import jax
import numpy as np

from kedge.core.manifolds import space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Rig
from kedge.estimation.step import Outcome

NO_SENSOR = -1
WORD = 8
"""Bytes: all in an event's row is as long, so that its pitch is a whole number of them."""


SENSOR, HAS_CONTROL, HAS_COV = 2, 3, 4
"""Words of an event's row."""
HEAD = SENSOR, HAS_COV + 1
ANSWER = ["verdict", "control", "replayed", "time"]
"""The first words of an answer's row."""
VERDICT, CONTROL, REPLAYED = range(3)


class Part(NamedTuple):
    """Where one array lies in a vector of numbers."""

    name: str
    shape: tuple[int, ...]
    place: slice


def words_of(rows: np.ndarray) -> np.ndarray:
    """The memory of rows as words, which are copied in a tenth of the time."""
    return rows.view(np.int64).reshape(len(rows), rows.dtype.itemsize // WORD)


def parts(names: Any, shapes: Any) -> tuple[Part, ...]:
    """Arrays one behind the other."""
    laid, begin = [], 0
    for name, shape in zip(names, shapes, strict=True):
        laid.append(Part(name, tuple(shape), slice(begin, begin + math.prod(shape))))
        begin += math.prod(shape)
    return tuple(laid)


def parts_of(tree: Any) -> tuple[Part, ...]:
    """The leaves of a tree, by their paths."""
    paths = jax.tree_util.tree_leaves_with_path(tree)
    names = [jax.tree_util.keystr(path).lstrip(".") for path, _ in paths]
    return parts(names, [np.shape(leaf) for _, leaf in paths])


def size_of(laid: tuple[Part, ...]) -> int:
    """How many numbers they are."""
    return laid[-1].place.stop if laid else 0


class EventForm:
    """The rows of events; ``control`` is one as it holds at the start."""

    def __init__(self, rig: Rig, control: Any):
        spaces = [space_of(one.sensor.measures) for one in rig.sensors]
        names = [getattr(space.cls, "_fields", ()) for space in spaces]
        self.measures = [one.sensor.measures for one in rig.sensors]
        self.sizes = [space.size for space in spaces]
        self.readings = [
            parts(fields, [chart.shape for chart in space.charts])
            for fields, space in zip(names, spaces, strict=True)
        ]
        self.sizes_read = [size_of(laid) for laid in self.readings]
        self.controls, self._control = parts_of(control), jax.tree.structure(control)
        widest = max((size_of(laid) for laid in self.readings), default=0)
        most = max((size**2 for size in self.sizes), default=0)
        self.dtype = np.dtype([
            ("time", np.int64), ("sequence", np.int64), ("sensor", np.int64),
            ("has_control", np.int64), ("has_cov", np.int64), ("target", np.int64),
            ("measurement", float, (widest,)), ("control", float, (size_of(self.controls),)),
            ("cov", float, (most,)), ("seconds", float), ("since", float), ("row", np.int64),
            ("held", float, (size_of(self.controls),)),
        ])  # fmt: skip
        self.pitch = self.dtype.itemsize // WORD
        fields: Any = self.dtype.fields
        self.words = {
            name: slice(begin // WORD, (begin + kind.itemsize) // WORD)
            for name, (kind, begin, *_) in fields.items()
        }

    def content(self, row: np.ndarray) -> bytes:
        """The words of a row that mean something, whatever the others are."""
        places = [slice(*HEAD)]
        if row[SENSOR] != NO_SENSOR:
            places += [self.words["target"], self.words["measurement"]]
        if row[HAS_COV]:
            places.append(self.words["cov"])
        if row[HAS_CONTROL]:
            places.append(self.words["control"])
        return b"".join(row[place].tobytes() for place in places)

    def blank(self, count: int) -> np.ndarray:
        """Rows of events at which nothing happens."""
        rows = np.zeros(count, self.dtype)
        rows["sensor"] = NO_SENSOR
        return rows

    def views(self, rows: np.ndarray, with_cov: int) -> Log:
        """The memory of rows by the names of a log; one sensor may bring covariances."""
        readings = []
        for rank, (measures, laid) in enumerate(zip(self.measures, self.readings, strict=True)):
            cov: Any = None
            if rank == with_cov:
                cov = _view(rows["cov"], slice(0, None), (self.sizes[rank],) * 2)
            leaves = [_view(rows["measurement"], p.place, p.shape) for p in laid]
            targets: Any = rows["target"]
            readings.append(Readings(measures(*leaves), targets, cov))
        controls = [_view(rows["held"], p.place, p.shape) for p in self.controls]
        when: Any = [rows[name] for name in ("seconds", "sensor", "row")]
        return Log(Schedule(*when), self._control.unflatten(controls), tuple(readings))

    def reading(self, row: Any, dtype: Any) -> Readings:
        """That of one row, in memory of its own."""
        rank = int(row["sensor"])
        given, size = np.array(row["measurement"], dtype), self.sizes[rank]
        leaves = [given[p.place].reshape(p.shape) for p in self.readings[rank]]
        target: Any = np.array(row["target"])
        cov: Any = None
        if row["has_cov"]:
            cov = np.array(row["cov"][: size**2], dtype).reshape(size, size)
        return Readings(self.measures[rank](*leaves), target, cov)

    def control(self, vector: np.ndarray, dtype: Any = float) -> Any:
        """A control from its numbers, in memory of its own."""
        own = np.array(vector, dtype)
        return self._control.unflatten([own[p.place].reshape(p.shape) for p in self.controls])


class AnswerForm:
    """The rows of answers: what became of an event, and what is believed after it.

    ``moments`` and ``record`` are trees of shapes and types; a record is what a smoother needs.
    """

    def __init__(self, silence: Outcome, moments: Any, record: Any = None):
        self._trees = {"moments": moments, "record": record}
        formats: list[Any] = [(name, np.int64) for name in ANSWER]
        for name, leaves in self._leaves():
            inside = [(f"f{i}", leaf.dtype, leaf.shape) for i, leaf in enumerate(leaves)]
            formats.append((name, np.dtype(inside, align=True)))
        others = [
            (name, leaf) for name, leaf in silence._asdict().items() if name not in ANSWER
        ]
        # What is of 64 bits first: the words of the moments are then theirs alone.
        others.sort(key=lambda pair: -pair[1].dtype.itemsize)
        formats += [(name, leaf.dtype, leaf.shape) for name, leaf in others]
        self.dtype = np.dtype(formats, align=True)
        begin, size = len(ANSWER), self.dtype["moments"].itemsize
        self.moments = slice(begin, begin - -size // WORD)
        """Words of an answer's row."""
        self.silence = np.zeros(1, self.dtype)
        for name, leaf in silence._asdict().items():
            self.silence[name] = leaf
        self.silence["control"] = Verdict.NONE
        self.quiet = words_of(self.silence)[0]

    def _leaves(self) -> list[tuple[str, list[Any]]]:
        leaves = {name: jax.tree.leaves(tree) for name, tree in self._trees.items()}
        return [(name, inside) for name, inside in leaves.items() if inside]

    def fields(self, rows: np.ndarray) -> list[np.ndarray]:
        """The memory of rows by the leaves of moments, outcome and record."""
        views = {
            name: [rows[name][f"f{i}"] for i in range(len(leaves))]
            for name, leaves in self._leaves()
        }
        outcome = [rows[name] for name in Outcome._fields]
        return [*views["moments"], *outcome, *views.get("record", ())]

    def outcome(self, row: Any) -> Outcome:
        """Of one row."""
        values: Any = [np.array(row[name]) for name in Outcome._fields]
        return Outcome(*values)

    def tree(self, row: Any, name: str = "moments") -> Any:
        """Moments or record of one row."""
        leaves, structure = jax.tree.flatten(self._trees[name])
        group = row[name]
        return structure.unflatten([np.array(group[f"f{i}"]) for i in range(len(leaves))])


def _view(block: np.ndarray, place: slice, shape: tuple[int, ...]) -> np.ndarray:
    """Arrays of that shape, one in each row, where they lie."""
    numbers = block[:, place]
    strides, inner = [], WORD
    for size in reversed(shape):
        strides.insert(0, inner)
        inner *= size
    return np.lib.stride_tricks.as_strided(
        numbers, (len(block), *shape), (block.strides[0], *strides)
    )
