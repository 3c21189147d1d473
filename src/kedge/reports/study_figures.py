"""Figures of a study: scores with intervals, curves over time, errors against members."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kedge.core.manifolds import Space
from kedge.evaluation.scores import Score
from kedge.reports import style
from kedge.reports.drawing import legend, logarithmic
from kedge.reports.study_curves import NisCurve, coarse
from kedge.reports.study_lines import (
    Line,
    Panel,
    fit,
    lines,
    members,
    panels,
    plot_line,
    series,
    short,
    study_looks,
)
from kedge.studies.figures_of_merit import StudyScores
from kedge.studies.summary import BASELINE, Curves, baseline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any

TIME = "time since the start of the run (s)"
FINE = (0.95, 1.02, 1.05, 1.3)
MARKS = (0.5, 0.7, 0.8, 0.9, *FINE, 1, 1.1, 1.2, 1.5, 2, 3, 5, 10, 20, 50, 100)
"""Of ratios; the fine ones where the axis spans little."""
Filters = Mapping[str, StudyScores]


@style.styled
def plot_scores(filters: Filters, label: str, factor: float | int = 1) -> Axes:
    """Draw every filter's score with its interval, and what was published beside it."""
    ax = _rows(list(filters), 1)[0]
    values = _dots(ax, {name: row.score for name, row in filters.items()}, factor)
    ax.plot([], [], "o", color=style.color("ink"), ms=5, label="here, 95 % interval")
    known = [
        (factor * row.published.rmse, place)
        for place, row in enumerate(filters.values())
        if row.published is not None
    ]
    if known:
        ax.plot(*zip(*known, strict=True), "D", color=style.color("ink"), ms=5)
        ax.lines[-1].set(mfc=style.color("paper"), label="published")
    _scale(ax, [*values, *(value for value, _ in known)])
    ax.set_xlabel(label)
    return legend(ax, 3)


@style.styled
def plot_tracking(filters: Filters, shown: Mapping[str, tuple[float, str]]) -> Any:
    """Draw how far from its route each filter's loop led the vehicle, with intervals.

    ``shown`` has, by what was watched, the factor and unit of its axis.
    """
    axes = _rows(list(filters), len(shown))
    for ax, (name, (factor, unit)) in zip(axes, shown.items(), strict=True):
        scores = {n: row.settled.tracking[name] for n, row in filters.items()}
        _scale(ax, _dots(ax, scores, factor))
        ax.set_xlabel(f"{style.words(name)}, rms" + f" ({unit})" * bool(unit))
    return axes


def _rows(names: Sequence[str], columns: int) -> Any:
    """Axes with a row for each filter."""
    height = 0.75 + 0.25 * max(len(names), 2)
    axes = style.subplots(1, columns, height, sharey=True)[0]
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylim(len(names) - 0.4, -0.6)
    for ax in axes:
        ax.grid(axis="y", visible=False)
    return axes


def _dots(ax: Axes, scores: Mapping[str, Score], factor: float | int) -> list[float]:
    """Draw a dot in its interval for each filter that has one; return the dots."""
    looks, dots = study_looks(list(scores)), []
    for row, (name, (value, *interval)) in enumerate(scores.items()):
        if not np.isfinite(value):
            continue
        if np.isfinite(interval).all():
            ends = [factor * max(end, 0.0) for end in interval]
            ax.plot(ends, [row, row], color=looks[name].color, lw=2.4, alpha=0.45)
            ax.lines[-1].set_solid_capstyle("butt")
        ax.plot([factor * value], [row], "o", color=looks[name].color, ms=5)
        dots.append(factor * value)
    return dots


def _scale(ax: Axes, values: Sequence[float]) -> None:
    """Logarithmic for scores of different size, from 0 for similar ones, near for the same."""
    known = [value for value in values if value > 0]
    if known and max(known) > 5 * min(known):
        ax.set_xscale("log")
        ax.set_xlim(left=max(ax.get_xlim()[0], min(known) / 2))
        decade_marks(ax.xaxis, ax.get_xlim())
    elif not known or max(known) > 1.3 * min(known):
        ax.set_xlim(left=0)


@style.styled
def plot_error(curves: Mapping[str, Curves], states: Space, each: bool) -> Any:
    """Draw the RMSE over the runs at each time: a row a field, a column a family.

    ``each``: by component (root mean square over them), not as the length of the error.
    """
    base, cuts = baseline(list(curves)), states.slices()
    whole = {n: np.concatenate([*c.rmse.values()]) for n, c in curves.items()}
    columns = panels(lines(whole))
    axes = _grid(len(cuts), len(columns), sharex=True, sharey="row")
    for row, (name, cut) in zip(axes, cuts.items(), strict=True):
        factor, symbol = style.shown(states.units[cut.start])
        size = cut.stop - cut.start
        factor, by = (factor / np.sqrt(size), " by component") if each else (factor, "")
        for ax, panel in zip(row, columns, strict=True):
            for line in panel.lines:
                curve = curves[line.names[0]]
                time, squares = coarse(curve.time, curve.rmse[name] ** 2)
                _over_time(ax, line, time, factor * np.sqrt(squares), panel, base)
        _finish(row, curves[base].time[-1])
        row[0].set_ylabel(f"{style.words(name)} RMSE{by}\n({symbol})")
    return _labelled(axes, columns)


@style.styled
def plot_study_nees(curves: Mapping[str, Curves], size: int) -> Any:
    """Draw the mean NEES over the runs with the bounds that it keeps 95 % of the time."""
    known = {name: c for name, c in curves.items() if np.isfinite(c.nees).any()}
    base, columns = baseline(list(known)), panels(lines({n: c.nees for n, c in known.items()}))
    axes = _grid(1, len(columns), sharex=True, sharey="row")
    time, bounds = known[base].time, known[base].nees_bounds
    for ax, panel in zip(axes[0], columns, strict=True):
        for line in panel.lines:
            c = known[line.names[0]]
            _over_time(ax, line, *coarse(c.time, c.nees), panel, base)
        _bounds(ax, time[[0, -1]], (np.full(2, bounds[0]), np.full(2, bounds[1])), size)
    _finish(axes[0], time[-1])
    axes[0, 0].set_ylabel(f"mean NEES (–), {size} is right")
    return _labelled(axes, columns)


@style.styled
def plot_study_nis(curves: Mapping[str, Sequence[NisCurve]], sensors: Sequence[str]) -> Any:
    """Draw the mean NIS over the runs, by component, with its bounds: a row a sensor."""
    base = baseline(list(curves))
    whole = {name: np.concatenate([c.nis for c in cs]) for name, cs in curves.items()}
    longest = max(len(values) for values in whole.values())
    columns = panels(
        lines({n: np.pad(v, (0, longest - len(v)), "reflect") for n, v in whole.items()})
    )
    axes = _grid(len(sensors), len(columns), sharex=True, sharey="row")
    for number, (row, sensor) in enumerate(zip(axes, sensors, strict=True)):
        for ax, panel in zip(row, columns, strict=True):
            for line in panel.lines:
                c = curves[line.names[0]][number]
                _over_time(ax, line, c.time, c.nis, panel, base)
            shown = curves[panel.lines[0].names[0]][number]
            _bounds(ax, shown.time, (shown.low, shown.high), 1)
        _finish(row, curves[base][number].end)
        row[0].set_ylabel(f"mean NIS of {style.words(sensor)}\nby component (–)")
    return _labelled(axes, columns)


@style.styled
def plot_members(filters: Filters, base: str, of: str) -> Axes:
    """Draw ratios to the baseline's error against the number of members, logarithmically."""
    ax, looks = style.given(None, 3.6), study_looks(list(filters))
    groups = series(list(filters))
    colours = style.looks(list(groups))
    for kind, group in groups.items():
        sizes = np.array([(members(name) or ("", 0))[1] for name in group], float)
        ratios = np.array([filters[name].ratio_to_baseline for name in group])
        tint = looks[group[-1]].color if len(groups) > 1 else colours[kind].color
        for size, (low, high) in zip(sizes.tolist(), ratios[:, 1:].tolist(), strict=True):
            ax.plot([size, size], [low, high], color=tint, lw=1.4)
        ax.plot(sizes, ratios[:, 0], "o-", color=tint, ms=4.5, lw=1.1, label=kind)
    ax.axhline(1, color=looks[base].color, lw=2.6, alpha=0.45, label=base)
    ax.set_xscale("log")
    counts = sorted({sized[1] for n in filters if (sized := members(n)) is not None})
    ax.set_xticks(_apart(counts), [style.count(n) for n in _apart(counts)])
    logarithmic(ax)
    low, high = ax.get_ylim()
    marks = [m for m in MARKS if low <= m <= high and (high < 1.5 * low or m not in FINE)]
    ax.set_yticks(marks, [f"{mark:g}" for mark in marks])
    ax.set(xlabel="members N", ylabel=f"{of} RMSE / that of {base} (–)")
    return legend(ax, 4)


def _apart(counts: Sequence[int]) -> list[int]:
    """Of rising numbers those whose labels do not touch on a logarithmic axis."""
    ticks: list[int] = []
    for count in counts:
        if not ticks or count >= 1.15 * ticks[-1]:
            ticks.append(count)
    return ticks


def _over_time(ax: Axes, line: Line, time: Any, values: Any, panel: Panel, base: str) -> None:
    values = np.where(values > 0, values, np.nan)
    broad = base == BASELINE and base in line.names
    label = short(line, panel)
    plot_line(ax, line, time, values, fit(label, 34) if panel.title else label, broad)


def _bounds(ax: Axes, time: Any, ends: tuple[Any, Any], right: float | int) -> None:
    """What a mean keeps to if the model is right."""
    ax.fill_between(time, *ends, color=style.color("truth"), lw=0, zorder=1)
    ax.collections[-1].set(alpha=0.2, label="95 % bounds")
    ax.axhline(right, color=style.color("muted"), lw=0.6, zorder=1)


def _finish(row: Any, end: float) -> None:
    """Time from 0; a logarithmic axis where the curves span much, with enough marks."""
    limits = [ax.dataLim for ax in row]
    low, high = min(box.y0 for box in limits), max(box.y1 for box in limits)
    for ax in row:
        ax.set_xlim(0, end)
        if high > 4 * low:
            logarithmic(ax)
            decade_marks(ax.yaxis, ax.get_ylim())


def decade_marks(axis: Any, ends: tuple[float, float]) -> None:
    """Label 1, 2 and 5 of each decade where there are few; every digit in half of one."""
    axis.set_major_formatter(lambda value, _: style.number(value, 1))
    axis.set_minor_locator(style.studio("matplotlib.ticker").NullLocator())
    if ends[1] < 100 * ends[0]:
        subs = (1, 2, 5) if ends[1] > 5 * ends[0] else range(1, 10)
        axis.set_major_locator(style.studio("matplotlib.ticker").LogLocator(subs=subs))


def _grid(rows: int, columns: int, **options: Any) -> Any:
    height = 0.9 + (2.5 if rows == 1 else 2.1) * rows
    return style.subplots(rows, columns, height, **options)


def _labelled(axes: Any, columns: Sequence[Panel]) -> Any:
    """Legends above the columns, time below."""
    for ax, panel in zip(axes[0], columns, strict=True):
        if len(columns) == 1:
            legend(ax, 4)
            continue
        title = "others" if panel.title == "single" else panel.title
        ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), title=title, alignment="left")
        ax.get_legend().get_title().set(fontweight="bold", fontsize=9)
    for ax in axes[-1]:
        ax.set_xlabel(TIME if len(columns) < 3 else "time (s)")
    return axes
