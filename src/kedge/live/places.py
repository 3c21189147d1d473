"""Where a belief has its vehicle, on a map: whatever the vehicle's state is."""

import math
from typing import Any, NamedTuple

import numpy as np

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space
from kedge.evaluation.attitudes import angles_of
from kedge.evaluation.consistency import chi_square_bound

BOUND_95 = math.sqrt(chi_square_bound(2, 0.95))
"""Deviations within which 95 % of a plane normal distribution lie."""


class Place(NamedTuple):
    """A pose on the map, and the 95 % ellipse of its position; m and rad."""

    x: float
    y: float
    heading: float
    profile: float
    major: float
    minor: float
    angle: float
    sigma_profile: float


def heading_of(state: Any) -> float:
    """Counter-clockwise from the x axis; that of the bow where the state has an attitude."""
    if hasattr(state, "heading"):
        return float(state.heading)
    if hasattr(state, "attitude"):
        return float(angles_of(np.asarray(state.attitude)[None]).heading[0])
    return 0.0


def place_of(belief: Gaussian) -> Place:
    """The place of a belief whose state has a position of two or three numbers."""
    position = np.asarray(belief.mean.position)
    begin = space(belief.mean).slices()["position"].start
    cov = np.asarray(belief.cov)[begin : begin + len(position), begin : begin + len(position)]
    spread, axes = np.linalg.eigh(cov[:2, :2])
    minor, major = BOUND_95 * np.sqrt(np.maximum(spread, 0.0))
    depth = len(position) > 2
    return Place(
        float(position[0]),
        float(position[1]),
        heading_of(belief.mean),
        float(position[2]) if depth else 0.0,
        float(major),
        float(minor),
        math.atan2(axes[1, 1], axes[0, 1]),
        float(np.sqrt(max(cov[2, 2], 0.0))) if depth else 0.0,
    )
