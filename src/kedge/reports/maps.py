"""Maps: paths in plan with targets, equal scales, of logs, of studies and of fixes."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from kedge.estimation.log import Truth
from kedge.estimation.rig import Rig
from kedge.evaluation.score import Run
from kedge.reports import style
from kedge.reports.drawing import broken, ellipses, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any

Targets = Mapping[str, tuple[tuple[str, ...], np.ndarray]]
"""By sensor: the ids on its map and where they stand."""


Corners = tuple[np.ndarray, np.ndarray]
"""Lower left and upper right of a view in plan."""


def arena(points: Sequence[Float[np.ndarray, "_ _"]]) -> Corners:
    """The view of all that is known to be there, with a margin, and never a line."""
    plan = np.concatenate([part[:, :2] for part in points])
    low, high = np.nanmin(plan, axis=0), np.nanmax(plan, axis=0)
    whole = max(float((high - low).max()), 1e-3)
    half = np.maximum((high - low) / 2, 0.12 * whole) + 0.08 * whole
    return (low + high) / 2 - half, (low + high) / 2 + half


def map_axes(view: Corners, ax: Axes | None = None, highest: float = 8.4) -> Axes:
    """Axes of equal scales for a view, new ones unless they are given."""
    low, high = view
    height = 7.4 * float((high - low)[1] / (high - low)[0]) + 0.9
    ax = style.given(ax, min(max(height, 3.4), highest))
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.set(xlabel="east, x (m)", ylabel="north, y (m)")
    return ax


def draw_targets(ax: Axes, targets: Targets, named: bool = True) -> None:
    """Draw what sensors aim at, a marker a sensor, with ids if they are to be named."""
    for marker, (sensor, (names, where)) in zip("^DPv*s" * 5, targets.items(), strict=False):
        ax.plot(*where.T[:2], marker, color=style.color("target"), ms=4.5, zorder=5)
        ax.lines[-1].set_label(f"targets of {style.words(sensor)}")
        if named:
            _draw_ids(ax, names, where[:, :2])


def draw_ends(ax: Axes, path: Float[np.ndarray, "_ _"], end: bool = True) -> None:
    """Mark where a path starts and where it ends."""
    ends: Any = {"color": style.color("ink"), "ls": "none", "ms": 6, "zorder": 6}
    ax.plot(*path[:1, :2].T, marker="o", mfc=style.color("paper"), label="start", **ends)
    if end:
        ax.plot(*path[-1:, :2].T, marker="s", label="end", **ends)


def strays(path: Float[np.ndarray, "_ _"], ax: Axes) -> bool:
    """Whether a path is cut off by the view of a map."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    x, y = path.T[:2]
    return bool(np.any((x < left) | (x > right) | (y < bottom) | (y > top)))


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
    low, high = view = _view(among, truth, targets)
    ax = map_axes(view, ax)
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
    draw_targets(ax, targets)
    draw_ends(ax, path[np.isfinite(path).all(axis=1)])
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
    maps: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
    for installation in rig.sensors:
        where = getattr(getattr(installation.sensor, "target", None), "position", None)
        if where is None:
            continue
        where = np.asarray(where)
        if any(np.array_equal(where, other) for _, other in maps.values()):
            continue
        numbers = tuple(str(i) for i in range(len(where)))
        maps[installation.name] = names.get(installation.name, numbers), where
    return maps


def leaves(run: Run, ax: Axes) -> bool:
    """Whether a run's path is cut off by the view of a map."""
    return strays(_path(run), ax)


def _path(run: Run) -> Float[np.ndarray, "K d"]:
    return np.asarray(run.track.mean.position)


def _view(runs: Sequence[Run], truth: Truth | None, targets: Targets) -> Corners:
    known = truth.fields.get("position") if truth is not None else None
    paths = [known] if known is not None else [_path(run) for run in rivals(runs)]
    return arena([*paths, *(where for _, where in targets.values())])


def rivals(runs: Sequence[Run]) -> list[Run]:
    """The runs that are no baselines; all, if they all are."""
    return [run for run in runs if not style.is_baseline(run.name)] or list(runs)


def _draw_ids(ax: Axes, names: tuple[str, ...], where: np.ndarray) -> None:
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
