"""Figures of what moves in space: height, attitude, and the drift of a track."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kedge.core.manifolds import space_of
from kedge.estimation.log import Truth
from kedge.evaluation.attitudes import angles_of
from kedge.evaluation.score import Run
from kedge.evaluation.truth import longest_gap
from kedge.reports import style
from kedge.reports.drawing import (
    TIME,
    broken,
    draw_band,
    envelope,
    legend,
    logarithmic,
    over_time,
    shade_gaps,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any

SETTLED = 0.02
"""Share of the path after which an error is shown as a share of it."""


def is_spatial(run: Run) -> bool:
    """Whether the run's position has a height."""
    position = getattr(run.track.mean, "position", None)
    return position is not None and np.shape(position)[1:] == (3,)


def has_attitude(run: Run) -> bool:
    """Whether the run's state has an attitude in space."""
    attitude = getattr(run.track.mean, "attitude", None)
    return attitude is not None and np.shape(attitude)[1:] == (4,)


@style.styled
def plot_heights(
    runs: Sequence[Run], main: Run, truth: Truth | None, ax: Axes | None = None
) -> Axes:
    """Draw the height over time, in the band of three deviations of the run ``main``.

    The view is that of truth and ``main``; what strays beyond it is cut off.
    """
    ax = style.given(ax, 2.9)
    looks = style.looks([run.name for run in runs])
    shade_gaps(ax, main)
    known = [_height(main)]
    if truth is not None and "position" in truth.fields:
        known.append(truth.fields["position"][:, 2])
        ax.plot(
            *broken(truth.time, np.stack([truth.time, known[1]], axis=1)),
            color=style.color("truth"),
            lw=2.6,
            alpha=0.3,
            label="truth",
        )
    cut = _cut(main, "position")
    half = 3 * np.sqrt(main.track.cov[:, cut, cut][:, 2, 2])
    color, time = looks[main.name].color, main.track.time
    ax.fill_between(
        time, known[0] - half, known[0] + half, color=color, alpha=0.17, lw=0, label="± 3σ"
    )
    for run in sorted(runs, key=lambda run: not style.is_baseline(run.name)):
        look = looks[run.name]
        height = envelope(run.track.time, _height(run))
        ax.plot(*height, color=look.color, ls=look.dash, lw=0.9 * look.width, label=run.name)
    ends = [(float(np.nanmin(values)), float(np.nanmax(values))) for values in known]
    low, high = min(low for low, _ in ends), max(high for _, high in ends)
    margin = max(0.15 * (high - low), float(np.quantile(half, 0.9)), 0.05)
    ax.set_ylim(low - margin, high + margin)
    over_time(ax, main)
    ax.set(xlabel=TIME, ylabel="height, z (m)")
    return legend(ax, 5)


@style.styled
def plot_attitude(run: Run, truth: Truth | None, axes: Any = None, color: Any = None) -> Any:
    """Draw heading, pitch and roll over time, each in its band of three deviations."""
    if axes is None:
        axes = style.subplots(3, 1, 0.55 + 3 * 1.45, sharex=True)[:, 0]
    cut, degree = _cut(run, "attitude"), np.degrees(1.0)
    angles = angles_of(run.track.mean.attitude, run.track.cov[:, cut, cut])
    true = None
    if truth is not None and "attitude" in truth.fields:
        true = angles_of(truth.fields["attitude"])
    names = ("heading from east", "pitch, nose up", "roll, right side down")
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        values = np.unwrap(angles[index])
        if true is not None and truth is not None:
            actual = np.unwrap(true[index])
            near = np.interp(truth.time, run.track.time, values)
            actual += 2 * np.pi * np.round(np.median(near - actual) / (2 * np.pi))
            path = np.stack([truth.time, degree * actual], axis=1)
            ax.plot(*broken(truth.time, path), color=style.color("truth"), lw=2.6, alpha=0.3)
            ax.lines[-1].set_label("truth")
        band = 3 * degree * angles.std[index]
        draw_band(ax, run, run.track.time, degree * values, band, "state", color)
        ax.set_ylabel(f"{name} (°)")
    axes[-1].set_xlabel(TIME)
    legend(axes[0], 4)
    return axes


@style.styled
def plot_drift(runs: Sequence[Run], truth: Truth, ax: Axes | None = None) -> Axes:
    """Draw the error of the position in per cent of the distance that was covered so far."""
    ax = style.given(ax, 2.8)
    looks, position = style.looks([run.name for run in runs]), truth.fields["position"]
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    gone = np.where(np.diff(truth.time) <= longest_gap(truth.time), steps, 0.0)
    covered = np.concatenate([[0.0], np.cumsum(gone)])
    for run in runs:
        if run.errors is None:
            continue
        distance = np.interp(run.errors.time, truth.time, covered)
        size = np.linalg.norm(run.errors.error[:, run.errors.fields["position"]], axis=1)
        late = distance > SETTLED * covered[-1]
        share = 100 * size[late] / distance[late]
        look = looks[run.name]
        line = envelope(distance[late], np.where(share > 0, share, np.nan), 300)
        ax.plot(*line, color=look.color, ls=look.dash, lw=0.8 * look.width, label=run.name)
    logarithmic(ax)
    ax.set_xlim(0, covered[-1])
    ax.set(xlabel="distance covered (m)", ylabel="error / distance covered (%)")
    return legend(ax, 5)


def _height(run: Run) -> np.ndarray:
    return np.asarray(run.track.mean.position)[:, 2]


def _cut(run: Run, field: str) -> slice:
    return space_of(type(run.track.mean)).slices()[field]
