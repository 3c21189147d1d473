"""Figures of errors and states over time: each a plot on given or new axes, which it returns.

All by the names and units of fields, never by the kind of vehicle. Matplotlib is imported when
a figure is made, and its global state is left alone.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError
from kedge.core.manifolds import space_of
from kedge.evaluation.consistency import chi_square_bound, coverage, nees
from kedge.evaluation.score import Errors, Run
from kedge.reports import style
from kedge.reports.drawing import (
    TIME,
    draw_band,
    envelope,
    legend,
    logarithmic,
    over_time,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any


class Component(NamedTuple):
    """One component of a state over time."""

    label: str
    unit: str
    values: Float[np.ndarray, " K"]
    std: Float[np.ndarray, " K"]


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
    std, components = np.sqrt(np.diagonal(run.track.cov, axis1=1, axis2=2)), []
    for (name, cut), chart in zip(states.slices().items(), states.charts, strict=True):
        if name in known or chart.shape != chart.tangent_shape:
            continue
        values = np.asarray(getattr(run.track.mean, name)).reshape(len(std), chart.size)
        if chart.unit == "rad" and chart.size == 1:
            values = np.unwrap(values, axis=0)
        for i in range(cut.start, cut.stop):
            part = values[:, i - cut.start]
            components.append(Component(states.labels[i], states.units[i], part, std[:, i]))
    return components


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
        known = ~np.isnan(error).any(axis=1)
        inside = style.percent(float(coverage(error[known], cov[known])))
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
