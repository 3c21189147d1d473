"""What ranges are off by: offsets and scales of anchors, delays of radios."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from kedge.core.errors import DataError

TUKEY = 4.685
"""Beyond so many standard deviations a residual counts no more."""


class Line(NamedTuple):
    r"""A radio's ranges against true distances: $D = s\,d + b + e$."""

    offset: float  # m
    scale: float
    std: float
    """Of the residuals that count, m."""
    std_errors: tuple[float, float]
    """Of the offset and the scale."""
    used: int
    """Residuals that count, of ``samples``."""
    samples: int


def fit_line(distance: Any, measured: Any, with_scale: bool = True) -> Line:
    """Offset and scale of one anchor, whatever share of its ranges is far off.

    Least squares again and again with Tukey's weights, in units of the median absolute
    residual; it starts from the medians, so up to nearly half of the ranges may be wrong.

    Raises:
        DataError: too few ranges, or all at one distance where a scale is asked for.

    Source: P. Huber, E. Ronchetti, "Robust Statistics", 2nd ed., 2009, section 7.8.
    """
    d, z = np.asarray(distance, float).ravel(), np.asarray(measured, float).ravel()
    valid = np.isfinite(d) & np.isfinite(z) & (z > 0)
    d, z = d[valid], z[valid]
    if len(d) < 3:
        raise DataError(f"calibration: found {len(d)} usable ranges, expected 3 or more")
    if with_scale and np.ptp(d) < 1e-3 * max(d.max(), 1e-9):
        raise DataError(
            f"calibration: all ranges are of one distance, {d.mean():.4g} m, which tells no "
            "scale; ask for the offset only"
        )
    rows = np.stack([np.ones_like(d), d], axis=1) if with_scale else np.ones((len(d), 1))
    fixed = 0.0 if with_scale else d
    slope = _slope(d, z) if with_scale else 1.0
    point = np.array([np.median(z - slope * d), slope][: rows.shape[1]])
    weights, std = np.ones(len(d)), 1.0
    for _ in range(50):
        residuals = z - fixed - rows @ point
        std = max(1.4826 * float(np.median(np.abs(residuals))), 1e-12)
        weights = np.maximum(1 - (residuals / (TUKEY * std)) ** 2, 0.0) ** 2
        lean = rows * weights[:, None]
        point = np.linalg.solve(lean.T @ rows, lean.T @ (z - fixed))
    residuals = z - fixed - rows @ point
    kept = weights > 0
    std = float(np.sqrt(np.mean(residuals[kept] ** 2)))
    spread = std * np.sqrt(np.diag(np.linalg.inv((rows * weights[:, None]).T @ rows)))
    return Line(
        float(point[0]),
        float(point[1]) if with_scale else 1.0,
        std,
        (float(spread[0]), float(spread[1]) if with_scale else 0.0),
        int(kept.sum()),
        len(d),
    )


def calibrate(
    places: Any, anchors: Any, ranges: Any, rise: Any = 0.0, with_scale: bool = True
) -> list[Line]:
    """A line for each anchor, from ranges measured where the place was known.

    Args:
        places: of the tag, surveyed or of a trajectory with reference; n x d, m.
        anchors: m x d, m.
        ranges: n x m, m; NaN where there is none.
        rise: height of the tag over each anchor, where places are in the plane, m.
        with_scale: look for a scale too.

    Raises:
        DataError: as :func:`fit_line`, with the anchor's number; shapes that do not fit.
    """
    p, a, z = (np.asarray(value, float) for value in (places, anchors, ranges))
    if p.ndim != 2 or a.ndim != 2 or z.shape != (len(p), len(a)) or p.shape[1] != a.shape[1]:
        raise DataError(
            f"calibration: found places {p.shape}, anchors {a.shape} and ranges {z.shape}, "
            "expected (n, d), (m, d) and (n, m)"
        )
    far = np.linalg.norm(p[:, None] - a[None], axis=2)
    far = np.hypot(far, np.broadcast_to(np.asarray(rise, float), len(a))[None])
    lines = []
    for number in range(len(a)):
        try:
            lines.append(fit_line(far[:, number], z[:, number], with_scale))
        except DataError as error:
            raise DataError(f"anchor {number + 1}: {error}") from error
    return lines


def tag_places(position: Any, heading: Any, arm: Any) -> Float[np.ndarray, "n 2"]:
    """Where a tag is that is mounted ``arm`` (forward, left; m) from the vehicle's origin."""
    p, h = np.asarray(position, float), np.asarray(heading, float)
    forward, left = np.asarray(arm, float)
    turn = np.stack(
        [np.cos(h) * forward - np.sin(h) * left, np.sin(h) * forward + np.cos(h) * left], axis=1
    )
    return p + turn


def link_biases(
    position: Any, heading: Any, arms: Any, anchors: Any, ranges: Any, rise: Any = 0.0
) -> Float[np.ndarray, "k m"]:
    """The offset of every pair of a tag and an anchor, for several tags on one vehicle.

    Args:
        position: of the vehicle, n x 2, m.
        heading: rad.
        arms: where each tag is, forward and left, k x 2, m.
        anchors: m x 2, m.
        ranges: k x n x m, m; NaN where there is none.
        rise: height of the tags over each anchor, m.

    Raises:
        DataError: as :func:`calibrate`.
    """
    biases = []
    for arm, measured in zip(np.asarray(arms, float), np.asarray(ranges, float), strict=True):
        places = tag_places(position, heading, arm)
        biases.append(
            [line.offset for line in calibrate(places, anchors, measured, rise, False)]
        )
    return np.array(biases)


class Delays(NamedTuple):
    """The delay of each radio, m, with standard errors."""

    delay: Float[np.ndarray, " k"]
    std_error: Float[np.ndarray, " k"]


def antenna_delays(pairs: Any, biases: Any, std: Any = 0.05) -> Delays:
    r"""Delays $\delta$ of radios from the biases of pairs, $b_{ij} = \delta_i + \delta_j$.

    Args:
        pairs: two numbers of radios a row, from 0.
        biases: of each pair, measured less true distance, m.
        std: of a bias, m.

    Raises:
        DataError: the pairs do not determine every radio's delay; three radios that measure one
            another do.
    """
    index, bias = np.asarray(pairs, int), np.asarray(biases, float)
    if index.ndim != 2 or index.shape != (len(bias), 2):
        raise DataError(f"delays: found pairs {index.shape} and biases {bias.shape}")
    count = index.max() + 1
    rows = np.zeros((len(bias), count))
    for row, (one, other) in enumerate(index):
        rows[row, one] += 1
        rows[row, other] += 1
    weights = 1 / np.broadcast_to(np.asarray(std, float), bias.shape)
    lean = rows * weights[:, None]
    if np.linalg.matrix_rank(lean) < count:
        raise DataError(
            f"delays: {len(bias)} pairs do not determine the delays of {count} radios; each "
            "needs to be in a ring of an odd number of radios"
        )
    cov = np.linalg.inv(lean.T @ lean)
    return Delays(cov @ lean.T @ (bias * weights), np.sqrt(np.diag(cov)))


def usable_pairs(ranges: Float[np.ndarray, "m m"]) -> Bool[np.ndarray, "m m"]:
    """Pairs that have a range in one or both directions."""
    usable = np.isfinite(ranges) & (ranges > 0)
    usable = usable | usable.T
    np.fill_diagonal(usable, False)
    return usable


def _slope(d: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]) -> float:
    """A slope that outliers do not move: the median over pairs of the near and the far half."""
    order = np.argsort(d)
    half = len(d) // 2
    near, far = order[:half], order[len(d) - half :]
    apart = d[far] - d[near]
    wide = apart > 0.2 * np.ptp(d)
    return float(np.median((z[far] - z[near])[wide] / apart[wide]))
