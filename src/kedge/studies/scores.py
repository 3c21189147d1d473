"""What is kept of a study's runs: scores by run, sums by time, and their addition by chunks.

A chunk leaves a :class:`Part`; a :class:`Tally` adds parts up in the order of their numbers, so
that the sums do not depend on who computed which, or when.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from kedge.core.errors import DataError

Values = Array | np.ndarray


class RunScores(NamedTuple):
    """What one filter's runs were worth; every leaf has a leading run axis."""

    time_mean_rms: Float[Values, "*runs"]
    squared: Float[Values, "*runs n"]
    """Mean squared error of each tangent component."""
    nees: Float[Values, "*runs"]
    """Mean NEES; NaN for states of more than 32 components, whose covariances are not kept."""
    coverage: Float[Values, "*runs"]
    """Share of times at which the truth lay in the 95 % ellipsoid."""
    within: Float[Values, "*runs n"]
    """Share of times at which each component of the truth lay within 3 standard deviations."""
    nis: Float[Values, "*runs sensors"]
    """Mean NIS of what was fused; NaN for measurements of more than 8 components."""
    nis_dof: Float[Values, "*runs sensors"]
    """Their mean degrees of freedom; NaN where nothing was fused."""
    tracked: Float[Values, "*runs watches"]
    """Mean squares of what the scenario's world watches, by step."""
    singular: Float[Values, "*runs"]
    """Share of times at which the covariance has no inverse, so that there is no NEES."""
    outlying: Float[Values, "*runs sensors"]
    """Share of what was judged that a gate refused or a robust loss weighed down."""


class TimeSums(NamedTuple):
    """Sums over runs that came out finite: by scored time (K) and by reading (E)."""

    total: Float[Values, ""]
    """How many runs."""
    squared: Float[Values, "K n"]
    nees: Float[Values, " K"]
    nis: Float[Values, " E"]
    nis_count: Float[Values, " E"]
    """Runs in which the reading was fused."""
    nis_dof: Float[Values, " E"]

    def plus(self, other: "TimeSums") -> "TimeSums":
        """Add sums over other runs."""
        pairs = zip(self, other, strict=True)
        return TimeSums(*(np.asarray(a) + np.asarray(b) for a, b in pairs))


class Result(NamedTuple):
    """One filter's study, or its share of a chunk."""

    runs: RunScores
    """After the burn-in."""
    whole: RunScores
    """Over all times."""
    sums: TimeSums
    seconds: float = 0.0
    """Of the filter's passes, without compiling; neither of simulating nor of scoring."""
    compile_seconds: float = 0.0
    compiler: str = ""
    """Whose code did the passes: native or xla; both, if machines differ."""
    example: Mapping[str, np.ndarray] = {}
    """The study's first run: fields of the mean at the scored times; empty in other chunks."""
    track: Mapping[str, np.ndarray] = {}
    """Its truth then, which is the filter's own where a guidance listens to it."""
    windows: Mapping[str, RunScores] = {}
    """Over the times of each of the study's windows."""


class Part(NamedTuple):
    """A chunk's runs, scored: a piece for each filter."""

    pieces: Mapping[str, Result]
    truth: Mapping[str, np.ndarray] = {}
    """The truth of the study's first run at the scored times; empty in other chunks."""
    readings: Mapping[str, np.ndarray] = {}
    """Its readings of fields of the state, by ``sensor.field``."""


class Tally:
    """Parts, added up in the order of their chunks.

    By run it keeps a few numbers, by time only sums.
    """

    def __init__(self, names: Sequence[str]):
        self.names = tuple(names)
        self.truth: Mapping[str, np.ndarray] = {}
        self.readings: Mapping[str, np.ndarray] = {}
        self._runs: dict[str, list[tuple[RunScores, ...]]] = {n: [] for n in names}
        self._latest: dict[str, Result] = {}

    def add(self, part: Part) -> None:
        """Take in the next chunk."""
        for name in self.names:
            piece, before = part.pieces[name], self._latest.get(name)
            self._runs[name].append((piece.runs, piece.whole, *piece.windows.values()))
            if before is not None:
                piece = piece._replace(
                    sums=before.sums.plus(piece.sums),
                    seconds=before.seconds + piece.seconds,
                    compile_seconds=before.compile_seconds + piece.compile_seconds,
                    compiler=" and ".join(
                        sorted({*before.compiler.split(" and "), piece.compiler})
                    ),
                    example=piece.example or before.example,
                    track=piece.track or before.track,
                )
            self._latest[name] = piece
        self.truth = part.truth or self.truth
        self.readings = part.readings or self.readings

    def results(self) -> dict[str, Result]:
        """Each filter's study so far.

        Raises:
            DataError: nothing was added.
        """
        if not self._latest:
            raise DataError("study: found no finished runs, expected at least one chunk")
        results = {}
        for name, latest in self._latest.items():
            runs, whole, *windows = map(_joined, zip(*self._runs[name], strict=True))
            by_window = dict(zip(latest.windows, windows, strict=True))
            results[name] = latest._replace(runs=runs, whole=whole, windows=by_window)
        return results


def pack(part: Part) -> dict[str, np.ndarray]:
    """A part as named arrays, for a file; filters go by their place."""
    arrays = {}
    for place, piece in enumerate(part.pieces.values()):
        for group in ("runs", "whole", "sums"):
            for field, leaf in getattr(piece, group)._asdict().items():
                arrays[f"{place}.{group}.{field}"] = np.asarray(leaf)
        for window, scores in piece.windows.items():
            for field, leaf in scores._asdict().items():
                arrays[f"{place}.windows.{field}.{window}"] = np.asarray(leaf)
        arrays[f"{place}.seconds"] = np.array([piece.seconds, piece.compile_seconds])
        arrays[f"{place}.compiler"] = np.array(piece.compiler)
        for group in ("example", "track"):
            fields = getattr(piece, group).items()
            arrays |= {f"{place}.{group}.{k}": np.asarray(v) for k, v in fields}
    arrays |= {f"truth.{k}": np.asarray(v) for k, v in part.truth.items()}
    return arrays | {f"readings.{k}": np.asarray(v) for k, v in part.readings.items()}


def unpack(arrays: Mapping[str, np.ndarray], names: Sequence[str]) -> Part:
    """Undo :func:`pack`; ``names`` are the filters in their order.

    Raises:
        DataError: the arrays are not those of a part with these filters.
    """

    def below(prefix: str) -> dict[str, np.ndarray]:
        return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}

    pieces = {}
    try:
        for place, name in enumerate(names):
            seconds, compiling = arrays[f"{place}.seconds"].tolist()
            apart: dict[str, dict[str, np.ndarray]] = {}
            for key, leaf in below(f"{place}.windows.").items():
                field, _, window = key.partition(".")
                apart.setdefault(window, {})[field] = leaf
            pieces[name] = Result(
                RunScores(**below(f"{place}.runs.")),
                RunScores(**below(f"{place}.whole.")),
                TimeSums(**below(f"{place}.sums.")),
                seconds,
                compiling,
                str(arrays[f"{place}.compiler"]),
                below(f"{place}.example."),
                below(f"{place}.track."),
                {window: RunScores(**leaves) for window, leaves in apart.items()},
            )
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"a chunk's file is not of this version of kedge: {error}") from error
    return Part(pieces, below("truth."), below("readings."))


def finite(result: Result) -> Bool[np.ndarray, " runs"]:
    """Which runs came out finite."""
    whole, runs = result.whole, result.runs
    valid = np.isfinite(np.asarray(whole.squared)).all(axis=1)
    return valid & np.isfinite(np.asarray(runs.time_mean_rms))


def _joined(parts: Sequence[RunScores]) -> RunScores:
    columns: Any = zip(*parts, strict=True)
    return RunScores(*(np.concatenate(leaves) for leaves in columns))


def chunks_of(runs: int, chunk: int) -> int:
    """How many chunks there are."""
    return -(-runs // chunk)
