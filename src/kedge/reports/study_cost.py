"""What a study's filters cost, against what they are worth."""

from typing import TYPE_CHECKING, Any

import numpy as np

from kedge.reports import style
from kedge.reports.drawing import legend
from kedge.reports.study_figures import Filters, decade_marks
from kedge.reports.study_lines import family, study_looks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes = Any


@style.styled
def plot_cost(filters: Filters, label: str, factor: float | int = 1) -> Axes:
    """Draw every filter's score against its time for a run, both logarithmically.

    Joined are those that no other is both as fast as and as accurate as (Pareto's front).
    """
    ax, looks = style.given(None, 4.2), study_looks(list(filters))
    known = {n: s for n, s in filters.items() if s.score.value > 0 and s.seconds_per_run > 0}
    front = sorted(
        (1e3 * scores.seconds_per_run, factor * scores.score.value)
        for scores in known.values()
        if not scores.dominated_by
    )
    ax.plot(*np.reshape(front, (-1, 2)).T, color=style.color("muted"), lw=0.9, ls=(0, (3, 2)))
    ax.lines[-1].set_label("none is better in both")
    families: set[str] = set()
    for name, scores in known.items():
        kind = family(name)
        x, y = 1e3 * scores.seconds_per_run, factor * scores.score.value
        ax.plot([x], [y], "o", color=looks[name].color, ms=5)
        if scores.dominated_by:
            ax.lines[-1].set_markerfacecolor(style.color("paper"))
        if kind not in families:
            ax.lines[-1].set_label(kind)
        families.add(kind)
        options = name.removeprefix(kind).lstrip(":").replace("count=", "")
        ax.annotate(options, (x, y), (4, 4), textcoords="offset points", fontsize=7)
    ax.set(xscale="log", yscale="log")
    for axis, ends in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        decade_marks(axis, ends)
    ax.set(xlabel="time of one run (ms)", ylabel=label)
    return legend(ax, 6)
