"""Attitudes as people read them: heading, pitch and roll, with their spread."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Angles(NamedTuple):
    """Heading from east to the left, pitch with the nose up, roll with the right side down.

    All in rad; ``std`` in the same order, NaN if no covariance was given.
    """

    heading: Float[np.ndarray, " K"]
    pitch: Float[np.ndarray, " K"]
    roll: Float[np.ndarray, " K"]
    std: Float[np.ndarray, "3 K"]


def angles_of(
    attitude: Float[np.ndarray, "K 4"], cov: Float[np.ndarray, "K 3 3"] | None = None
) -> Angles:
    r"""Take unit quaternions (w, x, y, z) of a forward-left-up body apart.

    $R = R_z(\psi)\, R_y(-\theta)\, R_x(\varphi)$. ``cov`` is that of a small turn on the body's
    side, $R \exp(\delta)$; heading and roll are not known where the nose points straight up.

    Source: J. Diebel, "Representing attitude: Euler angles, unit quaternions, and rotation
    vectors", Stanford University, 2006, sections 5.6 and 8.2.
    """
    w, x, y, z = np.asarray(attitude).T
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2))
    down = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x**2 + y**2))
    std = np.full((3, len(w)), np.nan)
    if cov is not None:
        sin, cos, level = np.sin(roll), np.cos(roll), np.maximum(np.cos(down), 1e-6)
        zero, one = np.zeros_like(sin), np.ones_like(sin)
        rows = [
            [zero, sin / level, cos / level],
            [zero, cos, -sin],
            [one, sin * np.tan(down), cos * np.tan(down)],
        ]
        slopes = np.array([np.stack(row, axis=1) for row in rows])
        std = np.sqrt(np.einsum("aki,kij,akj->ak", slopes, cov, slopes))
    return Angles(heading, -down, roll, std)
