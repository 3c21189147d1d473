"""How a study's filters are told apart in figures: a colour a family, a shade a size."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.reports import style
from kedge.reports.style import Look
from kedge.studies.summary import baseline

AGREE = 1e-6
"""Curves that differ by less, relative to their size, are drawn as one."""
FEW = 6
"""As many lines can be told apart in one panel."""

_COLOURS = ["filter-1", "filter-2", "filter-3", "filter-4", "smoother", "odd", "filter-5"]
_COUNT = re.compile(r"([:,])count=(\d+)(?:,|$)")


class Line(NamedTuple):
    """What is drawn once for all filters whose curves agree."""

    names: tuple[str, ...]
    label: str
    look: Look


class Panel(NamedTuple):
    """Lines that are compared in one frame."""

    title: str
    lines: list[Line]


def family(name: str) -> str:
    """What a filter is, whatever its options: "ensemble" of ``ensemble:count=20``."""
    return name.split(":")[0]


def members(name: str) -> tuple[str, int] | None:
    """A filter's name without its number of members, and that number, if it has one."""
    count = _COUNT.search(name)
    if count is None:
        return None
    bare = name[: count.start(2) - len("count=")] + name[count.end(2) :].lstrip(",")
    return bare.rstrip(":,"), int(count[2])


def series(names: Sequence[str]) -> dict[str, list[str]]:
    """Filters that differ in nothing but their number of members, by rising number."""
    groups: dict[str, list[tuple[int, str]]] = {}
    for name in names:
        if (sized := members(name)) is not None:
            groups.setdefault(sized[0], []).append((sized[1], name))
    return {
        rest: [name for _, name in sorted(group)]
        for rest, group in groups.items()
        if len(group) > 1
    }


def study_looks(names: Sequence[str]) -> dict[str, Look]:
    """A colour for each family; its members from pale to full, by size or else in order."""
    families: dict[str, list[str]] = {}
    for name in names:
        families.setdefault(family(name), []).append(name)
    colours, looks = _family_looks(list(families)), {}
    for kind, group in families.items():
        ordered = sorted(group, key=_size)
        shades = np.linspace(0.35 if len(group) > 2 else 0.5, 1, len(group))
        shades = shades if len(group) > 1 else np.ones(1)
        for name, shade in zip(ordered, shades.tolist(), strict=True):
            looks[name] = colours[kind]._replace(alpha=round(shade, 2))
    return {name: looks[name] for name in names}


def _family_looks(families: Sequence[str]) -> dict[str, Look]:
    """The baseline first; a study has more families than a log report has runs."""
    base = baseline(families)
    looks = {n: look for n, look in style.looks(families).items() if style.is_baseline(n)}
    free = sorted((n for n in families if n not in looks), key=lambda n: n != base)
    for place, name in enumerate(free):
        turn, role = divmod(place, len(_COLOURS))
        looks[name] = Look(_COLOURS[role], style.DASHES[turn % len(style.DASHES)], 1.1)
    return looks


def lines(curves: Mapping[str, Float[np.ndarray, "..."]]) -> list[Line]:
    """One line for each curve; filters whose curves agree share the line of the first."""
    looks, groups = study_looks(list(curves)), []
    for name, curve in curves.items():
        size = float(np.max(np.abs(curve), initial=0.0, where=np.isfinite(curve)))
        for group in groups:
            other = curves[group[0]]
            if np.allclose(curve, other, rtol=0, atol=AGREE * size, equal_nan=True):
                group.append(name)
                break
        else:
            groups.append([name])
    return [Line(tuple(group), " = ".join(group), looks[group[0]]) for group in groups]


def panels(lines: Sequence[Line]) -> list[Panel]:
    """One panel for few lines; else one for each family of several, with the baseline."""
    if len(lines) <= FEW:
        return [Panel("", list(lines))]
    base = baseline([name for line in lines for name in line.names])
    reference = next(line for line in lines if base in line.names)
    kinds: dict[str, list[Line]] = {}
    for line in lines:
        if line is not reference:
            kinds.setdefault(family(line.names[0]), []).append(line)
    single = [group[0] for group in kinds.values() if len(group) == 1]
    split = [
        Panel(kind, [reference, *sorted(group, key=lambda line: line.look.alpha)])
        for kind, group in kinds.items()
        if len(group) > 1
    ]
    return [Panel("single", [reference, *single])] * bool(single) + split


def short(line: Line, panel: Panel) -> str:
    """A line's label where the panel's title says the family already."""
    if not panel.title or family(line.names[0]) != panel.title:
        return line.label
    name = line.names[0].removeprefix(panel.title).lstrip(":")
    return re.sub(r"\bcount=", "N = ", name).replace(",", ", ") or line.label


def featured(
    curves: Mapping[str, Float[np.ndarray, "..."]], wanted: Sequence[str] = (), most: int = 4
) -> list[str]:
    """The filters to show where all would hide each other.

    Those ``wanted``, as far as they are there; else of each family its largest, of which those
    whose curves agree count as one.
    """
    if chosen := [name for name in wanted if name in curves]:
        return chosen
    base = baseline(list(curves))
    best: dict[str, str] = {family(base): base}
    for name in curves:
        sized, kept = members(name), best.get(family(name))
        if kept is None or (
            kept != base and sized and sized[1] > (members(kept) or ("", 0))[1]
        ):
            best[family(name)] = name
    exact = [name for name in best.values() if not style.is_baseline(name)]
    drawn = lines({name: curves[name] for name in exact or best.values()})[:most]
    return [name for line in drawn for name in line.names]


def fit(text: str, width: int) -> str:
    """A label in lines of so many characters, broken where options end."""
    rows = [""]
    for part in re.split(r"(?<=[,=] )|(?<=,)(?=\w)", text):
        if rows[-1] and len(rows[-1] + part) > width:
            rows.append("")
        rows[-1] += part
    return "\n".join(row.strip() for row in rows)


def _size(name: str) -> int:
    sized = members(name)
    return 0 if sized is None else sized[1]


def plot_line(ax: Any, line: Line, x: Any, y: Any, label: str | None, base: bool) -> None:
    """Draw a curve; the baseline lies broad and pale beneath the others."""
    look = line.look
    width, alpha = (2.6, 0.45) if base else (look.width, look.alpha)
    ax.plot(x, y, color=look.color, ls=look.dash, lw=width, alpha=alpha, label=label)
    ax.lines[-1].set_zorder(1.9 if base else 2)
