"""Figures of readings: what a filter made of each, and whether they look as it expected."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import chdtr

from kedge.core.manifolds import space_of
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig
from kedge.evaluation.consistency import chi_square_bound, chi_square_interval, whiteness
from kedge.evaluation.score import Run
from kedge.reports import style
from kedge.reports.drawing import (
    LONG_GAP,
    TIME,
    envelope,
    legend,
    logarithmic,
    over_time,
    thinned,
    ticks,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any

LAGS = 30
DOTS = 1500  # of a cloud: more make the file larger, not the picture clearer


class Innovations(NamedTuple):
    """The readings of one sensor that a filter judged."""

    time: Float[np.ndarray, " n"]
    nis: Float[np.ndarray, " n"]
    dof: Int[np.ndarray, " n"]
    fused: Bool[np.ndarray, " n"]
    white: Float[np.ndarray, "f m"]
    """Of the fused ones, the components that were ever measured."""


def innovations(run: Run, recording: Recording, rig: Rig, sensor: str) -> Innovations:
    """Pick one sensor's innovations out of a run."""
    outcome, index = run.estimates.outcome, rig.index(sensor)
    nis, dof = np.asarray(outcome.nis), np.asarray(outcome.dof)
    mine = (np.asarray(recording.log.schedule.sensor) == index) & np.isfinite(nis) & (dof > 0)
    fused = np.asarray(outcome.verdict)[mine] == Verdict.FUSED
    size = space_of(rig.sensors[index].sensor.measures).size
    white = np.asarray(outcome.white)[mine][fused][:, :size]
    white = white[:, np.nansum(white**2, axis=0) > 0]
    return Innovations(np.asarray(run.estimates.time)[mine], nis[mine], dof[mine], fused, white)


def testable(innovations: Innovations) -> bool:
    """Whether there are enough innovations to speak of their autocorrelation."""
    return len(innovations.white) > LAGS and innovations.white.shape[1] > 0


@style.styled
def plot_nis(
    run: Run, recording: Recording, rig: Rig, sensor: str, ax: Axes | None = None
) -> Axes:
    """Draw a sensor's NIS, its gate, and its running mean against chi-square bounds."""
    ax = style.given(ax, 2.7)
    series, gate = innovations(run, recording, rig, sensor), rig.sensors[rig.index(sensor)].gate
    kinds = ((series.fused, "fused", "fused"), (~series.fused, "gated", "not fused"))
    for mask, role, label in kinds:
        chosen = thinned(mask, series.nis > np.quantile(series.nis, 0.98), DOTS)
        if len(chosen) < mask.sum():
            label += f" ({len(chosen)} of {mask.sum()})"
        if len(chosen):
            ax.plot(series.time[chosen], np.maximum(series.nis[chosen], 1e-2), ".", ms=4, mew=0)
            ax.lines[-1].set(color=style.color(role), alpha=0.55, label=label)
    dofs, sizes = np.unique(series.dof, return_counts=True)
    for dof, dash in zip(dofs[np.argsort(-sizes)][:2], ("-", (0, (2, 1.5))), strict=False):
        bound = chi_square_bound(int(dof), 1 - (gate or 0.01))
        name = f"gate: {gate:.2g} false alarms" if gate else "99 % of χ²"
        name += f", {dof} component{'s' * int(dof > 1)}" if len(dofs) > 1 else ""
        ax.axhline(bound, color=style.color("gated"), lw=1.0, ls=dash, label=name)
    _draw_mean(
        ax, series.time[series.fused], series.nis[series.fused], series.dof[series.fused]
    )
    logarithmic(ax)
    over_time(ax, run)
    ax.set(xlabel=TIME, ylabel=f"NIS of {style.words(sensor)} (–)")
    return legend(ax, 3, 1.8)


def _draw_mean(
    ax: Axes,
    time: Float[np.ndarray, " n"],
    nis: Float[np.ndarray, " n"],
    dof: Int[np.ndarray, " n"],
) -> None:
    """Draw the running mean of the fused readings and what it should keep to."""
    window = int(np.clip(len(nis) // 25, 5, 100))
    if len(nis) < 2 * window:
        return
    steps = np.diff(time, prepend=time[:1])
    broken = steps > max(LONG_GAP, 5 * float(np.median(steps)))
    parts = (time, nis, dof, broken)
    middle, mean, size, across = (
        np.convolve(part, np.ones(window) / window, "valid") for part in parts
    )
    mean = np.where(across > 0.5 / window, np.nan, mean)
    kept = np.unique(np.linspace(0, len(middle) - 1, 300).astype(int))
    bounds = np.array([chi_square_interval(float(d), window) for d in size[kept]])
    ax.fill_between(middle[kept], *bounds.T, color=style.color("truth"), lw=0)
    ax.collections[-1].set(alpha=0.22, label="95 % bounds of the mean")
    ax.plot(*envelope(middle, mean, 300), color=style.color("ink"), lw=1.1)
    ax.lines[-1].set_label(f"mean of {window} fused")


@style.styled
def plot_nis_histogram(
    run: Run, recording: Recording, rig: Rig, sensor: str, ax: Axes | None = None
) -> Axes:
    """Compare the distribution of a sensor's NIS with the chi-square law of its components."""
    ax = style.given(ax, 2.7)
    series = innovations(run, recording, rig, sensor)
    total = len(series.nis)
    edges = np.linspace(0, chi_square_bound(int(series.dof.max()), 0.998), 29)
    dofs, sizes = np.unique(series.dof, return_counts=True)
    law = np.stack([np.diff(chdtr(float(dof), edges)) for dof in dofs]).T @ sizes
    measured, _ = np.histogram(series.nis, edges)
    beyond = style.percent(float(np.mean(series.nis > edges[-1])))
    ax.stairs(100 * measured / total, edges, fill=True, color=style.color("fused"), alpha=0.5)
    ax.patches[-1].set_label(f"measured; {beyond} beyond")
    ax.stairs(100 * law / total, edges, color=style.color("ink"), lw=1.2, baseline=None)
    ax.patches[-1].set_label("χ² law")
    ax.set(xlabel=f"NIS of {style.words(sensor)} (–)", ylabel="share of readings (%)")
    ax.set(xlim=(0, edges[-1]), ylim=(0, None))
    return legend(ax, 2)


@style.styled
def plot_whiteness(
    run: Run, recording: Recording, rig: Rig, sensor: str, ax: Axes | None = None
) -> Axes:
    """Draw the autocorrelation of a sensor's innovations and the band that white ones keep."""
    ax = style.given(ax, 2.7)
    white = innovations(run, recording, rig, sensor).white
    test = whiteness(white, min(LAGS, len(white) - 1))
    ax.fill_between(test.lag, -test.band, test.band, color=style.color("truth"), lw=0)
    ax.collections[-1].set(alpha=0.2, label="95 % band")
    x = np.repeat(test.lag.astype(float), 3)
    y = np.stack([0 * test.band, test.autocorrelation, np.full(len(test.lag), np.nan)], axis=1)
    ax.plot(x, y.ravel(), color=style.color("fused"), lw=2.4, solid_capstyle="butt")
    ax.lines[-1].set_label("innovations")
    ax.axhline(0, color=style.color("muted"), lw=0.6)
    low, high = (f(test.autocorrelation) for f in (np.nanmin, np.nanmax))
    room = 1.6 * float(np.nanmax(test.band))
    ax.set_ylim(min(-room, 1.15 * low), max(room, 1.15 * high))
    ax.set(xlabel=f"lag (readings of {style.words(sensor)})", ylabel="autocorrelation (–)")
    return legend(ax, 2)


@style.styled
def plot_verdicts(run: Run, recording: Recording, rig: Rig, ax: Axes | None = None) -> Axes:
    """Draw when which sensor's readings met which verdict: a row each, with its count."""
    rows = verdict_rows(run, recording, rig)
    ax = style.given(ax, 0.95 + 0.24 * max(len(rows), 2))
    end, seen = float(np.asarray(run.estimates.time)[-1]), set()
    for height, (_, verdict, times) in enumerate(rows):
        name = _word(verdict)
        label = None if name in seen else name
        seen.add(name)
        tint = style.color(style.VERDICT_ROLES.get(verdict, "odd"))
        ax.plot(*ticks(times, height, end), color=tint, lw=0.7, label=label)
        ax.lines[-1].set_solid_capstyle("butt")
        ax.annotate(style.count(len(times)), (1.01, height), xycoords=ax.get_yaxis_transform())
        ax.texts[-1].set(va="center", color=style.color("muted"), fontsize=8)
    ax.set_yticks(range(len(rows)), [f"{style.words(s)}: {_word(v)}" for s, v, _ in rows])
    ax.set(ylim=(len(rows) - 0.4, -0.6), xlim=(0, end), xlabel=TIME, ylabel="sensor: verdict")
    ax.grid(axis="y", visible=False)
    legend(ax, 6)
    for line in ax.legend_.get_lines() if ax.legend_ else ():
        line.set_linewidth(4)
    return ax


def verdict_rows(
    run: Run, recording: Recording, rig: Rig
) -> list[tuple[str, Verdict, Float[np.ndarray, " n"]]]:
    """Sensor, verdict and times, for every verdict that a sensor's readings met."""
    verdict, time = np.asarray(run.estimates.outcome.verdict), np.asarray(run.estimates.time)
    sensor, rows = np.asarray(recording.log.schedule.sensor), []
    for index, installation in enumerate(rig.sensors):
        for kind in Verdict:
            times = time[(sensor == index) & (verdict == kind)]
            if len(times) and kind is not Verdict.NONE:
                rows.append((installation.name, kind, times))
    return rows


def _word(verdict: Verdict) -> str:
    return style.words(verdict.name.lower())
