"""Anchors that find their own places from the ranges between them."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from kedge.calibration.anchors import usable_pairs
from kedge.core.errors import DataError
from kedge.evaluation.trajectory import umeyama


class Survey(NamedTuple):
    """Places of anchors, up to the frame that the first three define."""

    anchors: Float[np.ndarray, "m 2"]
    """The first at the origin, the second on the x axis, the third to its left; m."""
    delays: Float[np.ndarray, " m"]
    """Of each radio, m; zeros where they were not looked for."""
    std: float
    """Of the residuals, m."""
    position_std: Float[np.ndarray, " m"]
    """Of each place, m, from the curvature at the solution."""


def self_survey(
    ranges: Any, std: float = 0.05, delay_std: float | None = 0.1, guess: Any = None
) -> Survey:
    r"""Places in the plane from ranges $D_{ij} = d_{ij} + \delta_i + \delta_j$ between anchors.

    Classical scaling of the squared ranges gives a start; then all ranges are fitted, with a
    delay for each radio that is drawn from $N(0, \sigma_\delta)$. Without delays
    (``delay_std`` None) their mean makes the whole layout larger.

    Args:
        ranges: m x m, m; means over repetitions, NaN where a pair was not measured.
        std: of a range, m.
        delay_std: of the delays, m.
        guess: rough places, m x 2; needed where pairs are missing.

    Raises:
        DataError: fewer than 4 anchors, or pairs that do not hold them together.

    Source: I. Borg, P. Groenen, "Modern Multidimensional Scaling", 2nd ed., 2005, section 12.1
    (the start).
    """
    measured = np.asarray(ranges, float)
    count = len(measured)
    if measured.shape != (count, count) or count < 4:
        raise DataError(f"survey: found ranges {measured.shape}, expected m x m, 4 or more")
    usable = usable_pairs(measured)
    rows, columns = np.nonzero(np.triu(usable))
    both = np.stack([measured[rows, columns], measured[columns, rows]])
    both = np.where(np.isfinite(both) & (both > 0), both, np.nan)
    value, copies = np.nanmean(both, axis=0), np.isfinite(both).sum(axis=0)
    if len(value) < 2 * count - 3:
        raise DataError(
            f"survey: found {len(value)} pairs of {count} anchors, expected {2 * count - 3} or "
            "more"
        )
    if guess is None:
        if len(value) < count * (count - 1) // 2:
            raise DataError(
                "survey: pairs are missing; expected a guess of the places to start"
            )
        places = _scaled(value, rows, columns, count)
    else:
        places = np.asarray(guess, float)
    places = framed(places)
    weight = np.sqrt(copies) / std
    free = [i for i in range(2 * count) if i not in (0, 1, 3)]

    def layout(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = places.ravel().copy()
        moved[free] = point[: len(free)]
        return moved.reshape(-1, 2), point[len(free) :]

    def misfit(point: np.ndarray) -> np.ndarray:
        at, delays = layout(point)
        expected = np.linalg.norm(at[rows] - at[columns], axis=1)
        if delay_std is None:
            return (value - expected) * weight
        errors = (value - expected - delays[rows] - delays[columns]) * weight
        return np.concatenate([errors, delays / delay_std])

    start = np.concatenate([places.ravel()[free], np.zeros(count if delay_std else 0)])
    fit = least_squares(misfit, start, "3-point", xtol=1e-15, ftol=1e-15, gtol=1e-12)
    positions, delays = layout(fit.x)
    spread = np.zeros(2 * count)
    spread[free] = np.diag(np.linalg.pinv(fit.jac.T @ fit.jac))[: len(free)]
    return Survey(
        positions,
        delays if delay_std else np.zeros(count),
        float(np.sqrt(np.mean((misfit(fit.x)[: len(value)] / weight) ** 2))),
        np.sqrt(spread.reshape(-1, 2).sum(axis=1)),
    )


def framed(places: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 2"]:
    """Moved, turned and if need be mirrored into the frame of the first three."""
    shifted = places - places[0]
    angle = np.arctan2(shifted[1, 1], shifted[1, 0])
    cos, sin = np.cos(angle), np.sin(angle)
    turned = shifted @ np.array([[cos, -sin], [sin, cos]])
    return turned * np.array([1.0, -1.0 if turned[2, 1] < 0 else 1.0])


def aligned(
    places: Float[np.ndarray, "m 2"], truth: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "m 2"]:
    """Moved and turned, not scaled, as near to ``truth`` as can be.

    Raises:
        DataError: all places are one.
    """
    return umeyama(places, truth, scaled=False).points(places)


def _scaled(
    value: np.ndarray, rows: np.ndarray, columns: np.ndarray, count: int
) -> Float[np.ndarray, "m 2"]:
    squared = np.zeros((count, count))
    squared[rows, columns] = squared[columns, rows] = value**2
    centre = np.eye(count) - 1 / count
    size, axes = np.linalg.eigh(-centre @ squared @ centre / 2)
    return axes[:, -2:] * np.sqrt(np.maximum(size[-2:], 1e-12))
