"""Localisation: sample correlations over long distances are noise, and are tapered away.

Distances are known before tracing, so tapers and neighbourhoods are constants of the program.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Neighbourhood(NamedTuple):
    """Which measured components each component of the state listens to, and how much."""

    places: Int[np.ndarray, "n k"]
    weight: Float[np.ndarray, "n k"]
    """What the precision of the measured component is multiplied by; 0 fills up the rows."""


def gaspari_cohn(distance: Float[np.ndarray, "..."], radius: float) -> Float[np.ndarray, "..."]:
    r"""Taper of compact support, 1 at distance 0 and 0 from ``radius`` on.

    With $r = 2 d / \text{radius}$: $1 - \tfrac53 r^2 + \tfrac58 r^3 + \tfrac12 r^4 -
    \tfrac14 r^5$ for $r \le 1$, $4 - 5 r + \tfrac53 r^2 + \tfrac58 r^3 - \tfrac12 r^4 +
    \tfrac1{12} r^5 - \tfrac{2}{3 r}$ up to $r = 2$. It resembles a Gaussian of standard
    deviation $\sigma = \text{radius} / 3.65$. Where the distance is NaN, nothing is tapered.

    Source: G. Gaspari, S. Cohn, "Construction of correlation functions in two and three
    dimensions", Q. J. R. Meteorol. Soc. 125, 1999, equation 4.10.
    """
    r = 2 * np.nan_to_num(np.asarray(distance, float), nan=0.0) / radius
    near = np.polynomial.polynomial.polyval(r, [1, 0, -5 / 3, 5 / 8, 1 / 2, -1 / 4])
    far = np.polynomial.polynomial.polyval(r, [4, -5, 5 / 3, 5 / 8, -1 / 2, 1 / 12])
    far = far - 2 / (3 * np.maximum(r, 1))
    return np.where(r <= 1, near, np.where(r < 2, np.maximum(far, 0.0), 0.0))


def neighbourhoods(distances: Float[np.ndarray, "m n"], radius: float) -> Neighbourhood:
    """The measured components within ``radius`` of each component of the state, tapered.

    Source: B. Hunt, E. Kostelich, I. Szunyogh, "Efficient data assimilation for spatiotemporal
    chaos: a local ensemble transform Kalman filter", Physica D 230, 2007, section 2.3.
    """
    weights = gaspari_cohn(distances, radius).T
    widest = max(int(np.count_nonzero(weights, axis=1).max()), 1)
    index = np.argsort(-weights, axis=1, kind="stable")[:, :widest]
    return Neighbourhood(index, np.take_along_axis(weights, index, axis=1))


def between(distances: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m m"]:
    """How far measured components are from each other.

    A measured component is taken to stand where the component of the state nearest to it does.
    """
    placed = np.where(np.isnan(distances), math.inf, distances)
    nearest = distances[:, np.argmin(placed, axis=1)]
    return (nearest + nearest.T) / 2
