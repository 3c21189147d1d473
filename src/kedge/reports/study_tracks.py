"""Figures of a study's first run: truth, readings and estimates."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.reports import style
from kedge.reports.drawing import envelope, legend
from kedge.reports.maps import Targets, arena, draw_ends, draw_targets, map_axes
from kedge.reports.study_figures import TIME
from kedge.reports.study_lines import Line, lines, plot_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any

DOTS = 1500
"""Of readings: more make the file larger, not the picture clearer."""
TURNS, MOST_TURNS = 30, 100
"""How often a truth that swings is shown to cross its middle, if it does more than so often."""


class Seen(NamedTuple):
    """One sensor's readings of a field of the state."""

    sensor: str
    time: Float[np.ndarray, " n"]
    values: Float[np.ndarray, "n d"]


class Track(NamedTuple):
    """A field of the state in the first run."""

    name: str
    unit: str
    time: Float[np.ndarray, " K"]
    truth: Float[np.ndarray, "K d"]
    estimates: Mapping[str, Float[np.ndarray, "K d"]]
    """By filter."""
    seen: Sequence[Seen] = ()
    driven: Mapping[str, Float[np.ndarray, "K d"]] = {}
    """In closed loops: the truth of each filter's own."""
    route: Float[np.ndarray, "K d"] | None = None
    """Where the vehicle was to be."""


@style.styled
def plot_component(track: Track, index: int, label: str) -> Any:
    """Draw one component: itself, and below how far readings and estimates lie from truth.

    In closed loops the truth of each filter's loop stands in place of its estimate.
    """
    factor, symbol = style.shown(track.unit)
    truth = factor * _continuous(track, track.truth[:, index])
    axes = style.subplots(2, 1, 4.6, sharex=True, height_ratios=[1.25, 1])[:, 0]
    upper, lower = axes
    if track.route is not None and index < track.route.shape[1]:  # a route may have no height
        _route(upper, track.time, factor * _continuous(track, track.route[:, index]))
    if not track.driven:
        upper.plot(*envelope(track.time, truth), color=style.color("truth"), lw=2.8, alpha=0.35)
        upper.lines[-1].set_label("truth")
        for seen in track.seen:
            time, values = _thinned(seen.time, factor * seen.values[:, index])
            name = f"readings of {style.words(seen.sensor)}"
            off = values - np.interp(time, track.time, truth)
            for ax, height in ((upper, values), (lower, off)):
                ax.plot(time, height, ".", color=style.color("target"), ms=2.4, alpha=0.45)
                ax.lines[-1].set_markeredgewidth(0)
            upper.lines[-1].set_label(name)
    drawn = _drawn(track)
    for place, line in enumerate(drawn):
        error = factor * _deviation(track, line, index)
        reference = factor * _continuous(track, _truth_of(track, line)[:, index])
        for ax, values in (
            (upper, reference if track.driven else truth + error),
            (lower, error),
        ):
            time, kept = envelope(track.time, values)
            plot_line(ax, line, time, kept, line.label if ax is upper else None, False)
            ax.lines[-1].set_linewidth(_width(place, len(drawn)))
    lower.axhline(0, color=style.color("muted"), lw=0.6)
    upper.set_ylabel(f"{label} ({symbol})")
    lower.set(ylabel=f"{label} − truth\n({symbol})", xlabel=TIME)
    step = float(np.median(np.diff(track.time))) if len(track.time) > 1 else 0.0
    lower.set_xlim(0 if track.time[0] < 2 * step else track.time[0], track.time[-1])
    limit = _limit(drawn, track, index, factor)
    lower.set_ylim(-limit, limit)
    legend(upper, 3, 2)
    return axes


@style.styled
def plot_plan(track: Track, targets: Targets) -> Axes:
    """Draw the first run in plan, with equal scales: truth, readings, estimates, targets.

    In closed loops: where each filter's loop led the vehicle.
    """
    points = [track.truth, *(where for _, where in targets.values())]
    points += [] if track.route is None else [track.route]
    ax = map_axes(arena(points), highest=7.0)
    if not track.driven:
        ax.plot(*track.truth.T[:2], color=style.color("truth"), lw=3.2, alpha=0.3)
        ax.lines[-1].set_label("truth")
        for seen in track.seen:
            _, values = _thinned(seen.time, seen.values)
            ax.plot(*values.T[:2], ".", color=style.color("target"), mew=0)
            ax.lines[-1].set(ms=2.6, alpha=0.5, label=f"readings of {style.words(seen.sensor)}")
    drawn, paths = _drawn(track), track.driven or track.estimates
    for place, line in enumerate(drawn):
        path = paths[line.names[0]]
        plot_line(ax, line, path[:, 0], path[:, 1], line.label, False)
        ax.lines[-1].set_linewidth(_width(place, len(drawn)))
    if track.route is not None:
        _route(ax, track.route[:, 0], track.route[:, 1])
    draw_targets(ax, targets, named=False)
    draw_ends(ax, track.truth, end=not track.driven)
    return legend(ax, 4, 1.4)


@style.styled
def plot_panels(track: Track, name: str) -> Any:
    """Draw one filter's first run in three panels: x over time, y over time, in plan."""
    axes = style.subplots(1, 3, 3.2)[0]
    estimate, time = track.estimates[name], track.time
    for index, ax in enumerate(axes[:2]):
        paths = (
            [(s.time, s.values[:, index]) for s in track.seen],
            (time, track.truth[:, index]),
        )
        _panel(ax, *paths, (time, estimate[:, index]))
        ax.set(xlabel="time (s)", ylabel=f"{'xy'[index]} ({track.unit})", xlim=(0, time[-1]))
    plan = [(s.values[:, 0], s.values[:, 1]) for s in track.seen]
    _panel(axes[2], plan, track.truth.T[:2], estimate.T[:2])
    axes[2].set(xlabel=f"x ({track.unit})", ylabel=f"y ({track.unit})", aspect="equal")
    legend(axes[0], 3, 1.4)
    return axes


def _panel(ax: Axes, seen: Sequence[Any], truth: Any, estimate: Any) -> None:
    """Readings below, the truth over them, and the estimate on top, thin enough for both."""
    for number, (x, y) in enumerate(seen):
        x, y = _thinned(x, y)
        ax.plot(x, y, ".", color=style.color("target"), ms=2, alpha=0.35, mew=0)
        ax.lines[-1].set_label(None if number else "readings")
    ax.plot(*truth, color=style.color("ink"), lw=1.8, label="truth")
    ax.plot(*estimate, color=style.color("gated"), lw=0.8, label="estimate")


@style.styled
def plot_profile(track: Track) -> Axes:
    """Draw the first run from the side: height over the way that was covered in plan.

    In closed loops: where each filter's loop led the vehicle.
    """
    ax, paths = style.given(None, 3.4), track.driven or track.estimates
    if not track.driven:
        ax.plot(_covered(track.truth), track.truth[:, 2], color=style.color("truth"), lw=3.2)
        ax.lines[-1].set(alpha=0.3, label="truth")
    drawn = _drawn(track)
    for place, line in enumerate(drawn):
        path = paths[line.names[0]]
        # Estimates stand at the way that was really covered, so that heights can be compared.
        along = _covered(path if track.driven else track.truth)
        plot_line(ax, line, along, path[:, 2], line.label, False)
        ax.lines[-1].set_linewidth(_width(place, len(drawn)))
    ax.set(xlabel="way covered in plan (m)", ylabel="height, z (m)")
    return legend(ax, 4, 1.4)


def _covered(path: Float[np.ndarray, "K d"]) -> Float[np.ndarray, " K"]:
    """The length of the path in plan, up to each point."""
    steps = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)
    return np.concatenate([np.zeros(1), np.cumsum(steps)])


def shown_span(track: Track) -> Track:
    """A truth that swings many times, cut to its last few: else it would be a black band."""
    middle = track.truth[:, 0] - np.median(track.truth[:, 0])
    crossings = np.flatnonzero(np.diff(np.signbit(middle)))
    if len(crossings) <= MOST_TURNS:
        return track
    begin = int(crossings[-TURNS])
    seen = [
        one._replace(
            time=one.time[one.time >= track.time[begin]],
            values=one.values[one.time >= track.time[begin]],
        )
        for one in track.seen
    ]
    return track._replace(
        time=track.time[begin:],
        truth=track.truth[begin:],
        estimates={name: values[begin:] for name, values in track.estimates.items()},
        seen=seen,
        driven={name: values[begin:] for name, values in track.driven.items()},
        route=None if track.route is None else track.route[begin:],
    )


def _drawn(track: Track) -> list[Line]:
    return lines({name: values.ravel() for name, values in track.estimates.items()})


def _width(place: int, count: int) -> float:
    """The lines below are wider, so that none hides behind its like."""
    return 1.0 + 0.8 * (count - 1 - place)


def _route(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    ax.plot(x, y, color=style.color("ink"), lw=0.8, ls=(0, (3, 2)), label="route", zorder=3)


def _truth_of(track: Track, line: Line) -> Float[np.ndarray, "K d"]:
    return track.driven.get(line.names[0], track.truth)


def _continuous(track: Track, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """Angles without jumps at the seam."""
    return np.unwrap(values) if track.unit == "rad" else values


def _thinned(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kept = np.linspace(0, len(time) - 1, min(DOTS, len(time))).astype(int)
    return time[kept], values[kept]


def _deviation(track: Track, line: Line, index: int) -> Float[np.ndarray, " K"]:
    """Estimate minus truth, for angles the shorter way round."""
    error = (track.estimates[line.names[0]] - _truth_of(track, line))[:, index]
    return (error + np.pi) % (2 * np.pi) - np.pi if track.unit == "rad" else error


def _limit(found: Sequence[Line], track: Track, index: int, factor: float) -> float:
    """Room for what a good filter does; readings and a filter that is lost may leave it."""
    sizes = [np.nanquantile(np.abs(_deviation(track, line, index)), 0.99) for line in found]
    best, worst = float(np.nanmin(sizes)), float(np.nanmax(sizes))
    return factor * max(1.6 * min(worst, 4 * best), 3 * best, 1e-9)
