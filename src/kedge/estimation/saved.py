"""The state of an online estimator as bytes: what it is of, its arrays, and a checksum."""

import hashlib
import json
import platform
import re
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from kedge.compiler.machine import key_of
from kedge.core.contracts import AbstractFilter
from kedge.core.errors import DataError
from kedge.estimation.compiled import Engine
from kedge.estimation.delayed import Origin, Window
from kedge.estimation.native_step import NativeSteps
from kedge.estimation.rig import Rig
from kedge.estimation.rows import HAS_CONTROL

MARK = b"kedge state 1\n"
"""The form of these bytes and its version."""
CHECK = hashlib.sha256().digest_size
ADDRESS = re.compile(r" at 0x[0-9a-f]+")
"""Of a function in a description: another in each process."""

Arrays = Mapping[str, np.ndarray]
S = TypeVar("S", bound="Saved")


class Settings(NamedTuple):
    """What an estimator was made with."""

    start: Any
    lag: float
    horizon: float
    capacity: int
    clock: str

    def plain(self) -> dict[str, Any]:
        """As JSON holds them."""
        kind = int if self.clock == "ns" else float
        start = None if self.start is None else kind(self.start)
        numbers = float(self.lag), float(self.horizon), int(self.capacity)
        return Settings(start, *numbers, self.clock)._asdict()


class Saved:
    """The part of an estimator that is kept as bytes and taken up again."""

    _belongs_here: Any
    _filter: Any
    _form: Any
    _key: Any
    _knows_start: bool
    _line: Any
    _rig: Any
    _settings: Settings
    _steps: Any
    clipped: dict[str, int]
    resets: int

    def state(self) -> bytes:
        """All that later answers hang on, but for filter, rig and key: for :meth:`from_state`.

        Raises:
            ContractError: another thread pushes.
        """
        self._belongs_here()
        line = self._line
        header = {
            "of": self._identity(),
            "settings": self._settings.plain(),
            "time": line.time,
            "knows_start": self._knows_start,
            "heard": list(line.heard.items()),
            "clipped": self.clipped,
            "resets": self.resets,
        }
        newest = {"after": line.after, "holds": line.held, "newest": line.newest}
        return write(header, newest | arrays_of(line.window))

    @classmethod
    def from_state(
        cls: type[S],
        state: bytes,
        filter: AbstractFilter,
        rig: Rig,
        key: PRNGKeyArray | None = None,
        engine: Engine = "auto",
    ) -> S:
        """An estimator that goes on where one was; all its answers are equal to the bit.

        Raises:
            DataError: the bytes are damaged or of another version, or the state is of another
                rig, filter, key, engine or kind of machine.
        """
        header, arrays = read(state)
        make: Any = cls
        estimator = make(filter, rig, key, engine=engine, **header["settings"])
        require_same(header["of"], estimator._identity())
        line = estimator._line
        restore(line.window, arrays, estimator._form.words["control"])
        line.time, line.heard = header["time"], dict(header["heard"])
        line.after, line.held, line.newest = (arrays[n] for n in ("after", "holds", "newest"))
        estimator._knows_start, estimator.clipped = header["knows_start"], header["clipped"]
        estimator.resets = header["resets"]
        return estimator

    def _identity(self) -> dict[str, str]:
        engine = "native" if isinstance(self._steps, NativeSteps) else "xla"
        return identity(self._filter, self._rig, self._key, engine)


def write(header: Mapping[str, Any], arrays: Arrays) -> bytes:
    """The mark, the digest of what follows, a line of JSON, and the arrays in turn."""
    laid = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    head = json.dumps({**header, "arrays": laid}).encode() + b"\n"
    body = head + b"".join(array.tobytes() for array in arrays.values())
    return MARK + hashlib.sha256(body).digest() + body


def read(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of :func:`write`.

    Raises:
        DataError: these are other bytes, of another version, or some of them have changed.
    """
    data = bytes(data)
    mark, _, _ = data[: len(MARK)].partition(b"\n")
    if not data.startswith(MARK):
        wanted = MARK.decode().strip()
        raise DataError(f"state: it begins with {mark!r}, expected {wanted!r}")
    body = data[len(MARK) + CHECK :]
    if hashlib.sha256(body).digest() != data[len(MARK) : len(MARK) + CHECK]:
        raise DataError("state: its checksum is wrong: some of its bytes are lost or changed")
    begin = body.index(b"\n") + 1
    header, arrays = json.loads(body[:begin]), {}
    for name, kind, shape in header.pop("arrays"):
        count, dtype = int(np.prod(shape, dtype=int)), np.dtype(kind)
        arrays[name] = np.frombuffer(body, dtype, count, begin).reshape(shape).copy()
        begin += count * dtype.itemsize
    return header, arrays


def identity(filter: Any, rig: Any, key: Any, engine: str) -> dict[str, str]:
    """What later answers hang on besides the state: by name, a digest or a version.

    Machine code is chosen by the processor, and so is what XLA makes: to the bit answers are
    the same on one kind of machine.
    """
    made_by = key_of("") if engine == "native" else version("jaxlib") + platform.processor()
    machine = " ".join((platform.machine(), made_by))
    return {
        "version of kedge": version("kedge-nav"),
        "rig": digest(rig),
        "filter": digest(filter),
        "key": digest(jax.random.key_data(key)),
        "engine": engine,
        "machine": hashlib.sha256(machine.encode()).hexdigest(),
    }


def require_same(given: Mapping[str, str], wanted: Mapping[str, str]) -> None:
    """Refuse a state of something else.

    Raises:
        DataError: the first thing that differs.
    """
    for name, value in wanted.items():
        if given.get(name) != value:
            was = str(given.get(name))
            raise DataError(
                f"state: it is of another {name}: found {was[:12]}, expected {value[:12]}"
            )


def digest(tree: Any) -> str:
    """Of all numbers of a tree, and of what else its nodes say."""
    leaves, structure = jax.tree.flatten(tree)
    hasher = hashlib.sha256(ADDRESS.sub("", str(structure)).encode())
    for leaf in map(np.asarray, leaves):
        hasher.update(f"{leaf.dtype.str}{leaf.shape}".encode() + leaf.tobytes())
    return hasher.hexdigest()


def arrays_of(window: Window) -> dict[str, np.ndarray]:
    """What a window remembers; the controls stand in its rows."""
    origin, kept = window.origin, [words is not None for words in window.words]
    count = len(window.orders)
    return {
        "times": np.array([origin.time, window.closed, window.full], np.int64),
        "origin": origin.words,
        "held": origin.held,
        "orders": np.array(window.orders, np.int64).reshape(count, 3),
        "rows": np.array(window.rows, np.int64),
        "kept": np.array(kept, bool),
        "words": np.array([words for words in window.words if words is not None]),
    }


def restore(window: Window, arrays: Arrays, place: slice) -> None:
    """Put them back into an empty window; ``place`` is that of a control in a row's words."""
    time, window.closed, window.full = arrays["times"].tolist()
    window.origin = Origin(time, arrays["origin"], arrays["held"])
    words = iter(arrays["words"])
    for order, row, kept in zip(
        arrays["orders"].tolist(), arrays["rows"], arrays["kept"], strict=True
    ):
        control = row[place].view(float).copy() if row[HAS_CONTROL] else None
        window.append(tuple(order), row.copy(), control, next(words).copy() if kept else None)
