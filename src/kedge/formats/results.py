"""What a command leaves behind: tables, summaries and the digests that pin them."""

import csv
import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tomli_w
from jaxtyping import Int

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.step import Outcome


def write_estimate(
    path: Path, stamps: Int[np.ndarray, " K"], moments: Gaussian, start: int
) -> None:
    """One row a time: stamp, s since ``start`` (ns), the state's components, their deviations.

    A component's deviation is that in its tangent space.
    """
    states = space_of(type(moments.mean))
    columns = {"stamp_ns": stamps, "time_s": (stamps - start) / 1e9}
    for names, leaf in zip(states.columns.values(), moments.mean, strict=True):
        values = np.asarray(leaf).reshape(len(stamps), -1)
        columns |= {name: values[:, i] for i, name in enumerate(names)}
    spread = np.sqrt(np.diagonal(np.asarray(moments.cov), axis1=1, axis2=2))
    columns |= {f"{label}_std": spread[:, i] for i, label in enumerate(states.labels)}
    write_csv(path, columns)


def write_verdicts(
    path: Path,
    stamps: Int[np.ndarray, " n"],
    targets: Sequence[str] | None,
    lines: Int[np.ndarray, " n"] | None,
    outcome: Outcome,
    labels: Sequence[str],
) -> None:
    """One row a reading of one sensor: what became of it, and why."""
    columns: dict[str, Any] = {"stamp_ns": stamps}
    if lines is not None:
        columns["line"] = lines
    if targets is not None:
        columns["target"] = np.asarray(targets)
    columns["verdict"] = np.asarray([Verdict(int(v)).name for v in np.asarray(outcome.verdict)])
    for name in ("nis", "dof", "threshold"):
        columns[name] = np.asarray(getattr(outcome, name))
    for i, label in enumerate(labels):
        columns[f"{label}_residual"] = np.asarray(outcome.residual)[:, i]
        columns[f"{label}_std"] = np.asarray(outcome.std)[:, i]
    write_csv(path, columns)


def write_table(path: Path, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """One row a filter, one column a scalar score; nested scores as ``rmse.position``.

    What there is of each target is left out: it stands in the summary.
    """
    flat = {
        name: {key: value for key, value in flatten(scores) if ".targets." not in key}
        for name, scores in rows.items()
    }
    header = list(dict.fromkeys(key for row in flat.values() for key in row))
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["filter", *header])
        for name, row in flat.items():
            writer.writerow([name, *(row.get(key, "") for key in header)])


def write_csv(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Numbers as the shortest text that reads back the same; not finite: an empty cell."""
    cells = [_cells(values) for values in columns.values()]
    with path.open("w") as file:
        file.write(",".join(columns) + "\n")
        file.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))


def write_summary(path: Path, summary: Mapping[str, Any]) -> None:
    """Machine-readable results; JSON has no NaN, so what is undefined becomes null."""
    path.write_text(json.dumps(plain(summary), indent=2, allow_nan=False) + "\n")


def plain(value: Any) -> Any:
    """A JSON value: arrays to lists, what is not finite to null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (np.ndarray, jax.Array)):
        return plain(np.asarray(value).tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def flatten(scores: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Scalars of nested scores by dotted name."""
    for key, value in scores.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{key}.")
        elif not isinstance(value, (list, tuple)):
            yield f"{prefix}{key}", value


def as_toml(table: Mapping[str, Any]) -> str:
    """A resolved configuration as TOML; TOML has no null, so what is None is left out."""
    return tomli_w.dumps(_without_null(table))


def _without_null(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _without_null(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_without_null(item) for item in value]
    return value


def digest(*parts: Any) -> str:
    """SHA-256 over arrays (their bytes), texts and plain values, in order."""
    hasher = hashlib.sha256()
    for part in parts:
        if isinstance(part, str):
            data = part.encode()
        elif isinstance(part, (np.ndarray, jax.Array)):
            data = np.ascontiguousarray(part).tobytes()
        else:
            data = json.dumps(plain(part), sort_keys=True).encode()
        # The length keeps two parts from meaning the same as their concatenation.
        hasher.update(len(data).to_bytes(8, "big") + data)
    return hasher.hexdigest()


def _cells(values: np.ndarray) -> list[str]:
    values = np.asarray(values)
    if values.dtype.kind != "f":
        return [_quoted(str(v)) for v in values.tolist()]
    return [repr(v) if math.isfinite(v) else "" for v in values.tolist()]


def _quoted(text: str) -> str:
    """As CSV wants it: quotes around what has a comma, a quote or a line break in it."""
    if any(mark in text for mark in ',"\n\r'):
        return '"' + text.replace('"', '""') + '"'
    return text
