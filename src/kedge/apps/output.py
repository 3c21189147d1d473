"""The files that every command leaves behind; the report is written apart."""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from kedge.config.problem import Problem
from kedge.core.manifolds import space_of
from kedge.evaluation.record import record
from kedge.evaluation.score import Run
from kedge.evaluation.scores import LogSummary
from kedge.formats.results import (
    digest,
    write_estimate,
    write_summary,
    write_table,
    write_verdicts,
)
from kedge.formats.tum import write_tum


def write_results(
    folder: Path, problem: Problem, runs: Sequence[Run], summary: LogSummary
) -> None:
    """Summary, table, trajectories and verdicts."""
    write_summary(folder / "summary.json", record(summary))
    write_table(folder / "table.csv", record(summary.filters))
    for run in runs:
        suffix = "" if len(runs) == 1 else f"_{file_name(run.name)}"
        track = run.track
        at = problem.recording.outputs
        moments = jax.tree.map(lambda leaf, at=at: np.asarray(leaf)[at], run.estimates.moments)
        write_estimate(
            folder / f"estimate{suffix}.csv", track.stamps, moments, problem.recording.start
        )
        if hasattr(track.mean, "position"):
            turn = getattr(track.mean, "heading", getattr(track.mean, "attitude", None))
            write_tum(folder / f"estimate{suffix}.tum", track.stamps, track.mean.position, turn)
        if not run.name.endswith(("+smoother", "+map")):
            _write_sensor_verdicts(folder, suffix, problem, run)


def _write_sensor_verdicts(folder: Path, suffix: str, problem: Problem, run: Run) -> None:
    sensor = np.asarray(problem.recording.log.schedule.sensor)
    row = np.asarray(problem.recording.log.schedule.row)
    for index, installation in enumerate(problem.rig.sensors):
        events = np.flatnonzero(sensor == index)
        if len(events) == 0:
            continue
        source = problem.sources[installation.name]
        rows = row[events]
        targets = None if source.targets is None else [source.targets[i] for i in rows]
        write_verdicts(
            folder / f"verdicts{suffix}_{file_name(installation.name)}.csv",
            source.stamps[rows],
            targets,
            source.lines[rows],
            jax.tree.map(lambda leaf, at=events: np.asarray(leaf)[at], run.estimates.outcome),
            space_of(installation.sensor.measures).labels,
        )


def file_name(name: str) -> str:
    """A name as part of a file's: no more than file systems take, and still one of its own."""
    text = "".join(c if c.isalnum() or c in "-+=." else "_" for c in name)
    return text if len(text.encode()) <= 100 else digest(name)[:16]
