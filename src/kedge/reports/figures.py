"""Figures of trajectories: each a plot on given or new axes, which it returns.

All by the names and units of fields, never by the kind of vehicle. Matplotlib is imported when
a figure is made, and its global state is left alone.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.core.manifolds import space_of
from kedge.estimation.log import Truth
from kedge.estimation.rig import Rig
from kedge.evaluation.consistency import chi_square_bound, coverage, nees
from kedge.evaluation.score import Errors, Run
from kedge.reports import style
from kedge.reports.drawing import (
    TIME,
    broken,
    draw_band,
    ellipses,
    envelope,
    legend,
    logarithmic,
    over_time,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any

Targets = Mapping[str, tuple[tuple[str, ...], np.ndarray]]
"""By sensor: the ids on its map and where they stand."""


class Component(NamedTuple):
    """One component of a state over time."""

    label: str
    unit: str
    values: Float[np.ndarray, " K"]
    std: Float[np.ndarray, " K"]


@style.styled
def plot_map(
    runs: Sequence[Run],
    truth: Truth | None,
    targets: Targets,
    ax: Axes | None = None,
    among: Sequence[Run] = (),
) -> Axes:
    """Draw paths in plan, 95 % ellipses of the first filter, and the targets with their ids.

    The view is the arena (truth and targets; without truth the filters' paths); what strays
    beyond it, such as dead reckoning, is cut off. A map among those of other runs has their
    view and keeps to their colours.
    """
    among = among or runs
    low, high = _view(among, truth, targets)
    height = 7.4 * float((high - low)[1] / (high - low)[0]) + 0.9
    ax = style.given(ax, min(max(height, 3.4), 8.4))
    path, looks = _path(rivals(runs)[0]), style.looks([run.name for run in among])
    if truth is not None and "position" in truth.fields:
        path = truth.fields["position"]
        ax.plot(*broken(truth.time, path), color=style.color("truth"), lw=2.6, alpha=0.3)
        ax.lines[-1].set_label("truth")
    for run in sorted(runs, key=lambda run: not style.is_baseline(run.name)):
        look = looks[run.name]
        ax.plot(*_path(run).T[:2], color=look.color, ls=look.dash, lw=0.8 * look.width)
        ax.lines[-1].set_label(run.name)
    if not style.is_baseline((main := rivals(runs)[0]).name):
        color = looks[main.name].color
        for index, outline in enumerate(ellipses(main, 30)):
            # What is larger than the view would only colour it, thirty times over.
            fits = (np.ptp(outline, axis=0) < high - low).all()
            face = (color, 0.07) if fits else "none"
            ax.fill(*outline.T, facecolor=face, edgecolor=color, lw=0.7, zorder=4)
            ax.patches[-1].set_label(None if index else "95 % ellipses")
    for marker, (sensor, (names, where)) in zip("^DPv*s" * 5, targets.items(), strict=False):
        ax.plot(*where.T[:2], marker, color=style.color("target"), ms=4.5, zorder=5)
        ax.lines[-1].set_label(f"targets of {style.words(sensor)}")
        _draw_targets(ax, names, where[:, :2])
    path = path[np.isfinite(path).all(axis=1)]
    ends: Any = {"color": style.color("ink"), "ls": "none", "ms": 6, "zorder": 6}
    ax.plot(*path[:1, :2].T, marker="o", mfc=style.color("paper"), label="start", **ends)
    ax.plot(*path[-1:, :2].T, marker="s", label="end", **ends)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.set(xlabel="east, x (m)", ylabel="north, y (m)")
    return legend(ax, 4)


@style.styled
def plot_maps(runs: Sequence[Run], truth: Truth | None, targets: Targets) -> Any:
    """Draw a map for each run, side by side: on one map, long tracks would hide each other."""
    low, high = _view(runs, truth, targets)
    slope, count = float((high - low)[1] / (high - low)[0]), len(runs)

    def height(columns: int) -> float:
        panel = slope * (0.93 * style.WIDTH - 0.5) / columns + 0.35
        return -(-count // columns) * panel + 0.75

    columns = next((n for n in range(1, count) if height(n) < 7.5), count)
    axes = style.subplots(-(-count // columns), columns, min(height(columns), 8.6)).ravel()
    looks, handles = style.looks([run.name for run in runs]), {}
    for ax, run in zip(axes, runs, strict=False):
        plot_map([run], truth, targets, ax, runs)
        drawn, labels = ax.get_legend_handles_labels()
        handles = dict(zip(labels, drawn, strict=True)) | handles
        handles.pop(run.name)  # the title says it
        ax.get_legend().remove()
        ax.set_title(run.name, color=looks[run.name].color)
        ax.label_outer()
    figure = axes[0].figure
    figure.legend(handles.values(), handles.keys(), loc="outside upper left", ncols=6)
    for _ in range(2):  # with equal aspects the layout settles only at the third drawing
        figure.draw_without_rendering()
    for ax in axes[count:]:
        ax.remove()
    return axes[:count]


def target_map(
    rig: Rig, names: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """By sensor, the ids and positions of its targets; a map that two share is shown once."""
    found: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
    for installation in rig.sensors:
        where = getattr(getattr(installation.sensor, "target", None), "position", None)
        if where is None:
            continue
        where = np.asarray(where)
        if any(np.array_equal(where, other) for _, other in found.values()):
            continue
        numbers = tuple(str(i) for i in range(len(where)))
        found[installation.name] = names.get(installation.name, numbers), where
    return found


def leaves(run: Run, ax: Axes) -> bool:
    """Whether a run's path is cut off by the view of a map."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    x, y = _path(run).T[:2]
    return bool(np.any((x < left) | (x > right) | (y < bottom) | (y > top)))


@style.styled
def plot_distance(runs: Sequence[Run], ax: Axes | None = None) -> Axes:
    """Draw every run's distance from truth over time, on a logarithmic axis."""
    ax = style.given(ax, 2.8)
    looks = style.looks([run.name for run in runs])
    for run in runs:
        if run.errors is None:
            continue
        field, cut = main_field(run.errors)
        factor, symbol = style.shown(run.errors.units[cut.start])
        size = factor * np.linalg.norm(run.errors.error[:, cut], axis=1)
        look = looks[run.name]
        time, size = envelope(run.errors.time, np.where(size > 0, size, np.nan), 300)
        ax.plot(time, size, color=look.color, lw=0.8 * look.width, label=run.name)
        ax.set_ylabel(f"{style.words(field)} error ({symbol})")
        over_time(ax, run)
    logarithmic(ax)
    ax.set_xlabel(TIME)
    return legend(ax, 5)


@style.styled
def plot_errors(run: Run, axes: Any = None, color: str | None = None) -> Any:
    """Draw truth minus estimate by component, each in its band of three standard deviations.

    Raises:
        DataError: the run was not compared with truth.
    """
    errors = run.errors
    if errors is None:
        raise DataError(f"{run.name}: there are no errors without truth")
    rows = len(errors.labels)
    if axes is None:
        each = 1.45 if rows <= 4 else 1.15
        axes = style.subplots(rows, 1, 0.55 + each * rows, sharex=True)[:, 0]
    std = np.sqrt(np.diagonal(errors.cov, axis1=1, axis2=2))
    for index, ax in enumerate(axes):
        factor, symbol = style.shown(errors.units[index])
        error, band = factor * errors.error[:, index], 3 * factor * std[:, index]
        draw_band(ax, run, errors.time, error, band, "error", color)
        limit = 1.12 * max(np.nanmax(np.abs(error), initial=0), np.quantile(band, 0.97), 1e-9)
        ax.set_ylim(-limit, limit)
        ax.set_ylabel(style.axis_label(errors.labels[index], symbol))
    axes[-1].set_xlabel(TIME)
    legend(axes[0], 4)
    return axes


@style.styled
def plot_states(run: Run, axes: Any = None, color: str | None = None) -> Any:
    """Draw the components that truth does not know, each in its band of three deviations."""
    components = unknown_to_truth(run)
    if axes is None:
        rows = len(components)
        axes = style.subplots(rows, 1, 0.55 + 1.3 * rows, sharex=True)[:, 0]
    for ax, (label, unit, values, std) in zip(axes, components, strict=True):
        factor, symbol = style.shown(unit)
        draw_band(ax, run, run.track.time, factor * values, 3 * factor * std, "state", color)
        ax.set_ylabel(style.axis_label(label, symbol))
    axes[-1].set_xlabel(TIME)
    legend(axes[0], 4)
    return axes


def unknown_to_truth(run: Run) -> list[Component]:
    """The components without errors; attitudes are left out, theirs are no coordinates."""
    states = space_of(type(run.track.mean))
    known = () if run.errors is None else run.errors.fields
    std, found = np.sqrt(np.diagonal(run.track.cov, axis1=1, axis2=2)), []
    for (name, cut), chart in zip(states.slices().items(), states.charts, strict=True):
        if name in known or chart.shape != chart.tangent_shape:
            continue
        values = np.asarray(getattr(run.track.mean, name)).reshape(len(std), chart.size)
        if chart.unit == "rad" and chart.size == 1:
            values = np.unwrap(values, axis=0)
        for i in range(cut.start, cut.stop):
            part = values[:, i - cut.start]
            found.append(Component(states.labels[i], states.units[i], part, std[:, i]))
    return found


@style.styled
def plot_nees(runs: Sequence[Run], axes: Any = None) -> Any:
    """Draw every run's NEES of its main field against the 95 % bound, on logarithmic axes."""
    judged = [(run, run.errors) for run in runs if run.errors is not None]
    rows = len(judged)
    if axes is None:
        axes = style.subplots(rows, 1, 0.6 + 1.15 * rows, sharex=True, sharey=True)[:, 0]
    looks, top = style.looks([run.name for run in runs]), 1e2
    for ax, (run, errors) in zip(axes, judged, strict=True):
        field, cut = main_field(errors)
        error, cov = errors.error[:, cut], errors.cov[:, cut, cut]
        values, bound = np.array(nees(error, cov)), chi_square_bound(error.shape[1], 0.95)
        there = ~np.isnan(error).any(axis=1)
        inside = style.percent(float(coverage(error[there], cov[there])))
        ax.axhspan(bound, 1e15, color=style.color("gated"), alpha=0.07, lw=0)
        ax.axhline(bound, color=style.color("gated"), lw=0.9, ls=(0, (4, 2)))
        ax.lines[-1].set_label("95 % bound" if ax is axes[0] else None)
        time, values = envelope(errors.time, np.maximum(values, 1e-3), 300)
        ax.plot(time, values, color=looks[run.name].color, lw=0.8)
        ax.lines[-1].set_label(f"{run.name}: {inside} of the errors inside")
        top = max(top, float(np.nanmax(values, initial=1.0)))
        logarithmic(ax)
        over_time(ax, run)
        ax.set(ylim=(1e-2, 2 * top), ylabel=f"NEES,\n{style.words(field)} (–)")
        legend(ax, 2)
    axes[-1].set_xlabel(TIME)
    return axes


def main_field(errors: Errors) -> tuple[str, slice]:
    """The field that a run is judged by: its position, or whatever comes first."""
    name = "position" if "position" in errors.fields else next(iter(errors.fields))
    return name, errors.fields[name]


def _path(run: Run) -> Float[np.ndarray, "K d"]:
    return np.asarray(run.track.mean.position)


def _view(
    runs: Sequence[Run], truth: Truth | None, targets: Targets
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the arena: all that is known to be there, a margin, and never a line."""
    known = truth.fields.get("position") if truth is not None else None
    paths = [known] if known is not None else [_path(run) for run in rivals(runs)]
    points = np.concatenate([p[:, :2] for p in [*paths, *(at for _, at in targets.values())]])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    whole = max(float((high - low).max()), 1e-3)
    half = np.maximum((high - low) / 2, 0.12 * whole) + 0.08 * whole
    return (low + high) / 2 - half, (low + high) / 2 + half


def rivals(runs: Sequence[Run]) -> list[Run]:
    """The runs that are no baselines; all, if they all are."""
    return [run for run in runs if not style.is_baseline(run.name)] or list(runs)


def _draw_targets(ax: Axes, names: tuple[str, ...], where: np.ndarray) -> None:
    """Write ids beside targets, away from the neighbours."""
    color = style.color("target")
    gaps = np.linalg.norm(where[:, None] - where[None], axis=2)
    near = gaps < 0.1 * max(float(gaps.max()), 1e-9)
    for name, point, group in zip(names, where, near, strict=True):
        away = point - where[group].mean(axis=0)
        length = float(np.hypot(*away))
        step = away / length if length > 1e-9 else np.array([0.7, 0.7])
        x, y = (8.5 * step).tolist()
        ax.annotate(name, point, (x, y), textcoords="offset points", fontsize=7.5)
        ax.texts[-1].set(color=color, ha="center", va="center", clip_on=True)
