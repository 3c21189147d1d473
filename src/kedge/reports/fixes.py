"""What fixes look like: in plan, and their residuals."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from kedge.positioning.fix import Fix
from kedge.reports import style
from kedge.reports.drawing import legend
from kedge.reports.maps import arena, draw_targets, map_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any


def residual_rows(fixes: Fix, names: tuple[str, ...]) -> list[list[str]]:
    """By anchor: how often it was used, and the median and spread of its residuals."""
    residuals, rows = np.asarray(fixes.residual), []
    for name, column in zip(names, residuals.T, strict=True):
        used = column[np.isfinite(column)]
        if len(used) == 0:
            rows.append([name, "0", "-", "-"])
            continue
        low, middle, high = np.quantile(used, [0.16, 0.5, 0.84])
        rows.append([name, style.count(len(used)), f"{middle:.3f}", f"{(high - low) / 2:.3f}"])
    return rows


@style.styled
def plot_fixes(
    fixes: Mapping[str, Fix],
    anchors: Float[np.ndarray, "m d"],
    names: tuple[str, ...],
    truth: Float[np.ndarray, "n d"] | None,
) -> Any:
    """Draw all fixes in plan, with the anchors and the true path."""
    looks = style.looks(list(fixes))
    ax = map_axes(arena([anchors] if truth is None else [anchors, truth]))
    for name, fix in fixes.items():
        place = np.asarray(fix.position)
        ax.plot(*place[:, :2].T, ".", ms=2.0, alpha=0.5, color=looks[name].color)
        ax.lines[-1].set_label(name)
    if truth is not None:
        ax.plot(*truth[:, :2].T, color=style.color("truth"), lw=2.6, alpha=0.5, label="truth")
        ax.plot(*truth[:1, :2].T, "x", color=style.color("truth"), ms=7)
    draw_targets(ax, {"ranges": (names, anchors)})
    return legend(ax, 4).figure


@style.styled
def plot_residuals(time: Float[np.ndarray, " n"], fixes: Fix, names: tuple[str, ...]) -> Any:
    """Draw the residuals of one solver over time, anchor by anchor."""
    residuals, count = np.asarray(fixes.residual), len(names)
    columns = min(count, 2)
    rows = -(-count // columns)
    axes = style.subplots(rows, columns, 0.6 + 1.3 * rows, sharex=True, sharey=True)
    for ax, name, values in zip(axes.ravel(), names, residuals.T, strict=False):
        ax.plot(time, values, ".", ms=1.5, color=style.color("filter-1"))
        ax.axhline(0, color=style.color("muted"), lw=0.6)
        ax.set_title(f"anchor {name}")
    for ax in axes[:, 0]:
        ax.set_ylabel("residual (m)")
    for ax in axes[-1]:
        ax.set_xlabel("time since the start of the log (s)")
    for ax in axes.ravel()[count:]:
        ax.remove()
    return axes[0, 0].figure
