"""Where to hang anchors: what a layout can do over an area, and which of several to take."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from kedge.core.errors import DataError

ROUNDS = 20
"""Of exchanges; each makes the layout better, or is the last."""


class Area(NamedTuple):
    """Places that a tag may be at, and what stands between them and the anchors."""

    places: Float[np.ndarray, "n 2"]
    """m."""
    walls: Float[np.ndarray, "w 2 2"]
    """From one end to the other, m."""
    std: float = 0.05
    """Of a range in line of sight, m."""
    blocked_std: float = np.inf
    """Of a range through a wall, its unknown excess included, m; infinite: it is of no use."""


def area(places: Any, walls: Any = (), std: float = 0.05, blocked_std: float = np.inf) -> Area:
    """An area from lists.

    Raises:
        DataError: no places, or none in the plane; noise that is not above 0.
    """
    points = np.asarray(places, float)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise DataError(f"placement: found places {points.shape}, expected n x 2, 1 or more")
    ends = np.asarray(walls, float).reshape(-1, 2, 2)
    if not (std > 0 and blocked_std > 0):
        raise DataError(f"placement: found noise {std:g} and {blocked_std:g} m, expected > 0")
    return Area(points, ends, std, blocked_std)


def blocked(area: Area, anchors: Any) -> Bool[np.ndarray, "n m"]:
    """Whether a wall stands between a place and an anchor."""
    p, a = area.places[:, None, None], np.asarray(anchors, float)[None, :, None]
    begin, end = area.walls[None, None, :, 0], area.walls[None, None, :, 1]
    apart = _side(p, a, begin) * _side(p, a, end) < 0
    across = _side(begin, end, p) * _side(begin, end, a) < 0
    return np.asarray((apart & across).any(axis=2))


def bounds(area: Area, anchors: Any) -> Float[np.ndarray, " n"]:
    r"""The least root mean square error at each place, m; infinite where there is no fix.

    $\sqrt{\operatorname{tr} J^{-1}}$ with $J = \sum_i u_i u_i^\top / \sigma_i^2$, where $u_i$
    points from anchor i to the place. Divided by the noise it is the dilution of precision.

    Source: S. M. Kay, "Fundamentals of Statistical Signal Processing: Estimation Theory",
    1993, section 3.9.
    """
    return _rms(_information(area, anchors).sum(axis=1))


def chosen(area: Area, candidates: Any, count: int) -> Int[np.ndarray, " count"]:
    """Which ``count`` of the candidates leave the smallest mean square bound over the area.

    One after the other, each the best beside those there are; then any is exchanged for any
    other as long as that helps. The result is at least a local optimum. While there are places
    without a fix, there are to be as few of them as can be.

    Args:
        area: where the tag may be.
        candidates: where an anchor can hang, m x 2, m.
        count: how many anchors there are.

    Raises:
        DataError: fewer than 2 anchors, or more than there are candidates.
    """
    parts = _information(area, candidates)
    if not 2 <= count <= parts.shape[1]:
        raise DataError(
            f"placement: found {count} anchors for {parts.shape[1]} candidates, expected 2 or "
            "more and no more than there are"
        )

    def cost(selection: list[int]) -> tuple[int, float, float]:
        information = parts[:, selection].sum(axis=1)
        rms = _rms(information)
        seen = np.isfinite(rms)
        # Where there is no fix yet, some information is better than none.
        total = np.trace(information, axis1=1, axis2=2).sum()
        return int((~seen).sum()), float((rms[seen] ** 2).sum()), -float(total)

    def best(others: list[int]) -> list[int]:
        candidates_left = [i for i in range(parts.shape[1]) if i not in others]
        return min(([*others, i] for i in candidates_left), key=cost)

    selection: list[int] = []
    for _ in range(count):
        selection = best(selection)
    for _ in range(ROUNDS):
        before = cost(selection)
        for place in range(count):
            selection = best(selection[:place] + selection[place + 1 :])
        if not cost(selection) < before:
            break
    return np.sort(np.array(selection))


def _information(area: Area, anchors: Any) -> Float[np.ndarray, "n m 2 2"]:
    """What each anchor tells at each place."""
    positions = np.asarray(anchors, float)
    away = area.places[:, None] - positions[None]
    unit = away / np.maximum(np.linalg.norm(away, axis=2), 1e-9)[:, :, None]
    std = np.where(blocked(area, positions), area.blocked_std, area.std)
    return unit[..., :, None] * unit[..., None, :] / (std**2)[:, :, None, None]


def _rms(information: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, " n"]:
    trace = np.trace(information, axis1=1, axis2=2)
    det = np.linalg.det(information)
    regular = det > 1e-9 * trace**2
    return np.sqrt(np.where(regular, trace / np.where(regular, det, 1.0), np.inf))


def _side(one: np.ndarray, other: np.ndarray, point: np.ndarray) -> np.ndarray:
    """On which side of a line a point is: twice the area of the triangle, with its sign."""
    along, away = other - one, point - one
    return along[..., 0] * away[..., 1] - along[..., 1] * away[..., 0]
