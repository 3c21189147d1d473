"""How kedge looks: roles and their colours, figure settings, numbers as far as they are known.

A colour stands for a role. Inside a report each is a CSS variable, so that one figure serves
light and dark screens and paper; the files beside it carry the light colours.
"""

import functools
import importlib
import io
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar

import numpy as np

from kedge.core.errors import KedgeError
from kedge.core.verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

P = ParamSpec("P")
T = TypeVar("T")

PALETTE = {  # role: (on light paper, on a dark screen)
    "ink": ("#1c2128", "#e6e9ee"),
    "muted": ("#5a636e", "#a3adb9"),
    "line": ("#dde1e6", "#343b44"),
    "paper": ("#ffffff", "#15191e"),
    "shade": ("#f3eee3", "#2a251b"),
    "warning": ("#a8330f", "#ff9b73"),
    "truth": ("#33393f", "#d3d8df"),
    "target": ("#54606c", "#98a4b1"),
    "dead-reckoning": ("#917a62", "#b7a08a"),
    "smoother": ("#00855f", "#3fc79b"),
    "filter-1": ("#0072b2", "#56b0e8"),
    "filter-2": ("#d55e00", "#f58b4c"),
    "filter-3": ("#b35c9c", "#dc92c8"),
    "filter-4": ("#b08400", "#e2b93f"),
    "filter-5": ("#4aa8dc", "#93d4fa"),
    "fused": ("#3d7f9e", "#6cb2d3"),
    "gated": ("#cc4425", "#f47c5d"),
    "late": ("#c98b12", "#e8b44d"),
    "odd": ("#8a4f9e", "#c293d4"),
    "dropped": ("#9c9285", "#8b8377"),
}
FILTERS = [role for role in PALETTE if role.startswith("filter-")]
PREFERRED = {"extended": 0, "kalman": 0, "unscented": 1, "ensemble": 2, "particle": 3}
DASHES = ["-", (0, (5, 1.2)), (0, (1.2, 1)), (0, (5, 1, 1, 1))]
BASELINES = ("dead-reckoning", "raw")
VERDICT_ROLES = {
    Verdict.FUSED: "fused",
    Verdict.GATED: "gated",
    Verdict.LATE: "late",
    Verdict.FUTURE: "late",
    Verdict.DUPLICATE: "late",
    Verdict.DROPPED: "dropped",
}  # the others are odd

PANEL = 16
"""Letters along the side of a low panel."""
WIDTH = 8.4  # in; 8.5 pt in it are 14 px on a page of 1000 px
RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so the layout is the same anywhere
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "axes.labelsize": 8.5,
    "axes.labelcolor": PALETTE["ink"][0],
    "axes.titlecolor": PALETTE["ink"][0],
    "axes.edgecolor": PALETTE["muted"][0],
    "axes.facecolor": PALETTE["paper"][0],
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.unicode_minus": True,
    "grid.color": PALETTE["line"][0],
    "grid.linewidth": 0.6,
    "text.color": PALETTE["ink"][0],
    "xtick.color": PALETTE["muted"][0],
    "ytick.color": PALETTE["muted"][0],
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "xtick.minor.size": 0,
    "ytick.minor.size": 0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.labelcolor": PALETTE["ink"][0],
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.4,
    "legend.borderaxespad": 0.2,
    "lines.linewidth": 1.0,
    "lines.solid_joinstyle": "round",
    "figure.facecolor": PALETTE["paper"][0],
    "figure.constrained_layout.use": True,
    "savefig.facecolor": PALETTE["paper"][0],
    "svg.fonttype": "none",
    "svg.hashsalt": "kedge",
    "path.simplify_threshold": 0.15,
}


class Look(NamedTuple):
    """How a run is drawn."""

    role: str
    dash: Any
    width: float
    alpha: float = 1.0

    @property
    def color(self) -> str:
        """Its colour on light paper."""
        return PALETTE[self.role][0]


def studio(module: str) -> Any:
    """Import a module of the extra that reports need.

    Raises:
        KedgeError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise KedgeError(
            f"a report needs {error.name}, which is not installed; "
            "install it with: pip install 'kedge-nav[studio]'"
        ) from error


def styled(plot: Callable[P, T]) -> Callable[P, T]:
    """Run a function under the settings of :data:`RC`, and leave the global ones alone."""

    @functools.wraps(plot)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
        with studio("matplotlib").rc_context(RC):
            return plot(*args, **kwargs)

    return wrapper


@styled
def subplots(rows: int = 1, columns: int = 1, height: float | int = 3.0, **options: Any) -> Any:
    """Make a figure without pyplot, hence without global state; return its axes."""
    figure = studio("matplotlib.figure").Figure(figsize=(WIDTH, height))
    return figure.subplots(rows, columns, squeeze=False, **options)


def given(ax: Axes | None, height: float | int) -> Axes:
    """The axes that were given, else new ones in a figure of their own."""
    return subplots(1, 1, height)[0, 0] if ax is None else ax


def color(role: str) -> str:
    """The colour of a role on light paper."""
    return PALETTE[role][0]


def is_baseline(name: str) -> bool:
    """Whether a run is what the filters have to beat."""
    return name.split(":")[0] in BASELINES


def is_smoother(name: str) -> bool:
    """Whether a run saw the whole log before it spoke."""
    return "smooth" in name.lower() or name.endswith("+map")


def looks(names: Sequence[str]) -> dict[str, Look]:
    """Give every run its look: a filter keeps its colour as long as no namesake has it."""
    found, free, baselines, smoothers = {}, list(FILTERS), 0, 0
    for name in names:
        if is_baseline(name):
            dash = [(0, (4, 2)), (0, (1.2, 1.2))][baselines % 2]
            found[name] = Look("dead-reckoning", dash, 1.0)
            baselines += 1
        elif is_smoother(name):
            found[name] = Look("smoother", DASHES[smoothers % len(DASHES)], 1.1)
            smoothers += 1
        else:
            wanted = FILTERS[PREFERRED.get(re.split(r"\W", name)[0], 4)]
            free = free or list(FILTERS)
            role = wanted if wanted in free else free[0]
            free.remove(role)
            seen = sum(look.role == role for look in found.values())
            found[name] = Look(role, DASHES[seen % len(DASHES)], 1.1)
    return found


@styled
def svg_of(figure: Figure) -> str:
    """The figure as an SVG file: the same figure gives the same bytes."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": "kedge"})
    figure.set_layout_engine("none")  # it is laid out now; the next format need not repeat it
    # A hundredth of a point is finer than any screen; the rest is two thirds of the file.
    return re.sub(r"(\d\.\d\d)\d+(?=[ \n\"])", r"\1", file.getvalue())


@styled
def save_png(figure: Figure, path: Any) -> None:
    """The figure as a picture for slides."""
    figure.savefig(path, format="png", dpi=160, pil_kwargs={"compress_level": 2})


def inlined(svg: str, name: str) -> str:
    """An SVG as part of a page: own ids, CSS variables for colours, no outside reference."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    box = re.search(r'viewBox="[^"]*"', body)
    start = f'<svg role="img" aria-labelledby="{name}-caption" {box.group() if box else ""}>'
    body = start + body[body.index(">") + 1 :]
    body = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', body)
    body = re.sub(r'(?:xlink:)?href="#([^"]+)"', rf'href="#{name}-\1"', body)
    body = body.replace("url(#", f"url(#{name}-")
    for role, (light, _) in PALETTE.items():
        body = body.replace(light, f"var(--{role})")
    return body


def number(value: float | int | None, digits: int = 3) -> str:
    """A number to some significant digits; a dash for one that is not known."""
    if value is None or not np.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    exponent = int(f"{value:.{digits - 1}e}".split("e")[1])  # after rounding: .0999 is .10
    if not -4 <= exponent < 6:
        raised = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        return _signed(f"{value / 10.0**exponent:.{digits - 1}f}") + f"·10{raised}"
    return _decimals(float(value), digits - 1 - exponent)


def measured(value: float | int, interval: Iterable[float] = ()) -> tuple[str, str]:
    """A number and its interval, as far as the interval lets it be known.

    To the place of the first digit of the interval's half-width (the second, if the first is a
    one), but never fewer than two digits; to three without an interval.
    """
    ends = [float(end) for end in interval]
    if len(ends) != 2 or not np.isfinite([value, *ends]).all() or ends[1] <= ends[0]:
        return number(value), ""
    half = (ends[1] - ends[0]) / 2
    exponent = int(np.floor(np.log10(half)))
    places = -exponent + (half < 2 * 10.0**exponent)
    if value:
        places = max(places, 1 - int(np.floor(np.log10(abs(value)))))
    places = min(places, 6)
    return _decimals(float(value), places), " to ".join(_decimals(x, places) for x in ends)


def percent(share: float | None) -> str:
    """A share in per cent; finer where it nears none or all."""
    if share is None or not np.isfinite(share):
        return "–"
    if 0 < share < 0.00995:
        return f"{number(100 * share, 1)}\u00a0%"
    fine = 0 < share < 0.0995 or 0.9905 < share < 1
    return f"{100 * share:.{1 if fine else 0}f}\u00a0%"


def count(value: int) -> str:
    """A count with thin spaces between thousands."""
    return f"{value:,}".replace(",", "\u202f")


def words(label: str) -> str:
    """A field or component as people write it: ``position_x`` is "position x"."""
    return label.replace("_", " ")


def axis_label(name: str, symbol: str) -> str:
    """For the side of a low panel, in lines that are no longer than it is high."""
    whole = f"{words(name)} ({symbol})"
    if len(whole) <= PANEL:
        return whole
    return "\n".join(textwrap.wrap(words(name), PANEL)) + f"\n({symbol})"


def shown(unit: str) -> tuple[float, str]:
    """What people read instead of a unit: degrees for radians."""
    if unit.startswith("rad"):
        return float(np.degrees(1.0)), "°" + unit[3:]
    return 1.0, {"1": "–", "m/s^2": "m/s²"}.get(unit, unit)


def _decimals(value: float, places: int) -> str:
    rounded = round(value, places)
    return _signed(f"{rounded:.{max(places, 0)}f}")


def _signed(text: str) -> str:
    return text.replace("-", "−")
