"""What several figures share: bands, gaps, thinning of long series, legends."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from kedge.core.manifolds import space_of
from kedge.core.verdicts import Verdict
from kedge.evaluation.consistency import chi_square_bound
from kedge.evaluation.score import Run
from kedge.evaluation.truth import longest_gap
from kedge.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any

TIME = "time since the start of the log (s)"
LONG_GAP = 10.0  # s without a fused reading that a figure points out
CHARACTERS = 130
"""Of a legend's row, with 8 for each of its marks."""
BINS = 450  # of a long series: with two points each, more cannot be told apart on a page


def envelope(
    time: Float[np.ndarray, " K"], values: Float[np.ndarray, " K"], bins: int = BINS
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Keep the least and the greatest value of each stretch, in the order of time."""
    if len(values) <= 2 * bins:
        return time, values
    size = -(-len(values) // bins)
    padded = np.pad(values, (0, -len(values) % size), constant_values=np.nan).reshape(-1, size)
    gone = np.isnan(padded)
    ends = [np.where(gone, np.inf, padded).argmin(1), np.where(gone, -np.inf, padded).argmax(1)]
    kept = np.sort(np.stack(ends, axis=1), axis=1) + size * np.arange(len(padded))[:, None]
    return time[kept.ravel()], values[kept.ravel()]


def thinned(
    chosen: Bool[np.ndarray, " n"], first: Bool[np.ndarray, " n"], most: int
) -> Int[np.ndarray, " m"]:
    """Indices of at most ``most`` of the chosen: an even share, ``first`` before the others."""
    indices = np.flatnonzero(chosen)
    if len(indices) <= most:
        return indices
    kept = np.flatnonzero(chosen & first)[:most]
    others = np.flatnonzero(chosen & ~first)
    room = np.linspace(0, len(others) - 1, most - len(kept)).astype(int)
    return np.sort(np.concatenate([kept, others[room]]))


def without_fused(run: Run) -> list[tuple[float, float]]:
    """Stretches of time without a fused reading; none if nothing was ever fused."""
    time = np.asarray(run.estimates.time)
    fused = time[np.asarray(run.estimates.outcome.verdict) == Verdict.FUSED]
    if not len(fused):
        return []
    marks = np.concatenate([[0.0], fused, time[-1:]])
    long = np.flatnonzero(np.diff(marks) > LONG_GAP)
    return [(float(marks[i]), float(marks[i + 1])) for i in long]


def shade_gaps(ax: Axes, run: Run) -> None:
    """Shade the times that the filter lived through on its prediction alone."""
    label = f"no reading fused for {LONG_GAP:g} s"
    for start, end in without_fused(run):
        ax.axvspan(start, end, color=style.color("shade"), lw=0, zorder=0, label=label)
        label = None


def draw_band(
    ax: Axes,
    run: Run,
    time: Float[np.ndarray, " K"],
    values: Float[np.ndarray, " K"],
    half: Float[np.ndarray, " K"],
    name: str,
    color: str | None,
) -> None:
    """Draw errors around zero, or estimates in a band around themselves."""
    color = color or style.looks([run.name])[run.name].color
    shade_gaps(ax, run)
    over_time(ax, run)
    if name == "error":
        when, upper = envelope(time, half)
        lower = -upper
        ax.axhline(0, color=style.color("muted"), lw=0.6)
    else:
        kept = np.unique(np.linspace(0, len(time) - 1, 2 * BINS).astype(int))
        when, lower, upper = time[kept], (values - half)[kept], (values + half)[kept]
    ax.fill_between(when, lower, upper, color=color, alpha=0.17, lw=0, label="± 3σ")
    label = "truth − estimate" if name == "error" else "estimate"
    ax.plot(*envelope(time, values), color=color, lw=0.9, label=f"{run.name}: {label}")


def broken(
    time: Float[np.ndarray, " K"], position: Float[np.ndarray, "K d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """A path in plan with its gaps left open."""
    x, y = position[:, 0], position[:, 1]
    cuts = np.flatnonzero(np.diff(time) > longest_gap(time)) + 1
    return np.insert(x, cuts, np.nan), np.insert(y, cuts, np.nan)


def ellipses(run: Run, count: int, probability: float = 0.95) -> Float[np.ndarray, "e 49 2"]:
    """Outlines of the regions that should hold the position, at even times, in plan."""
    chosen = np.unique(np.linspace(0, len(run.track.time) - 1, count).astype(int))
    start = space_of(type(run.track.mean)).slices()["position"].start
    cut = slice(start, start + 2)
    roots = np.linalg.cholesky(run.track.cov[chosen, cut, cut] + 1e-18 * np.eye(2)[None])
    angle = np.linspace(0, 2 * np.pi, 49)
    circle = np.sqrt(chi_square_bound(2, probability)) * np.stack(
        [np.cos(angle), np.sin(angle)], axis=1
    )
    centre = np.asarray(run.track.mean.position)[chosen, None, :2]
    return centre + np.einsum("eij,aj->eai", roots, circle)


def ticks(
    times: Float[np.ndarray, " n"], row: float | int, end: float, bins: int = 1000
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Upright strokes at ``row``, one for each stretch of time in which something happened."""
    width = max(end, 1e-9) / bins
    where = np.unique(np.floor(times / width)) * width + width / 2
    x = np.repeat(where, 3)
    y = np.tile([row - 0.36, row + 0.36, np.nan], len(where))
    return x, y


def over_time(ax: Axes, run: Run) -> None:
    """Let the axis of time span the log, no more."""
    ax.set_xlim(0, float(np.asarray(run.estimates.time)[-1]))


def logarithmic(ax: Axes) -> None:
    """Make the upright axis logarithmic, marked 0.1, 1, 10 rather than in powers."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(lambda value, _: style.number(value, 1))
    ax.minorticks_off()


def legend(ax: Axes, columns: int, scale: float | int = 1) -> Axes:
    """Put the legend above the axes, where it covers nothing; long names get fewer columns."""
    labels = ax.get_legend_handles_labels()[1]
    longest = max((len(label) for label in labels), default=0)
    columns = max(1, min(columns, CHARACTERS // (longest + 8)))
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=columns, markerscale=scale)
    return ax
