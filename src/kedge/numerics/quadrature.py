"""Points and weights that integrate a standard normal: the rules behind sigma-point filters."""

import functools as ft
import itertools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.errors import ContractError

LARGEST = 20_000
"""Points beyond which a rule is refused: each costs a run of the model at every event."""


class Rule(NamedTuple):
    """Points for a standard normal, the centre first (with weight 0 if the rule has none)."""

    points: Float[np.ndarray, "k n"]
    mean_weights: Float[np.ndarray, " k"]
    cov_weights: Float[np.ndarray, " k"]


def unscented(size: int, alpha: float = 1.0, beta: float = 0.0, kappa: float = 1.0) -> Rule:
    r"""The scaled unscented rule: points at 0 and $\pm\sqrt{\alpha^2 (n + \kappa)}\,e_i$.

    With the defaults all weights are positive, and the rule is exact to third order.

    Raises:
        ContractError: ``n + lambda`` is not positive.

    Source: S. Julier and J. Uhlmann, "Unscented filtering and nonlinear estimation", Proc.
    IEEE 92(3), 2004, sections III and VI; S. Julier, "The scaled unscented transformation",
    American Control Conference, 2002.
    """
    spread = alpha**2 * (size + kappa)
    if not spread > 0:
        raise ContractError(
            f"unscented rule of size {size}: alpha^2 (n + kappa) is {spread:g}, must be > 0; "
            f"found alpha={alpha:g}, kappa={kappa:g}"
        )
    arms = math.sqrt(spread) * np.eye(size)
    points = np.concatenate([np.zeros((1, size)), arms, -arms])
    mean = np.full(2 * size + 1, 0.5 / spread)
    mean[0] = 1 - size / spread
    cov = mean.copy()
    cov[0] += 1 - alpha**2 + beta
    return Rule(points, mean, cov)


def least_size(kappa: float) -> int:
    """The fewest variables for which the unscented rule exists: n + kappa is above 0."""
    return max(1, math.floor(-kappa) + 1) if math.isfinite(kappa) else 1


def cubature(size: int) -> Rule:
    r"""The third-degree spherical-radial rule: $\pm\sqrt n\,e_i$ with weights $1 / 2n$.

    The unscented rule whose centre has no weight, so all weights are positive in any size.

    Source: I. Arasaratnam and S. Haykin, "Cubature Kalman filters", IEEE Trans. Autom.
    Control 54(6), 2009, section IV.
    """
    return unscented(size, kappa=0.0)


@ft.cache
def gauss_hermite(size: int, order: int = 3) -> Rule:
    r"""The tensor product of the ``order`` points that are exact to degree $2p - 1$ each.

    All weights are positive. There are $p^n$ points, and one more at the centre, without
    weight, if the order is even.

    Raises:
        ContractError: ``order`` is below 2, or there are more than ``LARGEST`` points.

    Source: K. Ito and K. Xiong, "Gaussian filters for nonlinear filtering problems", IEEE
    Trans. Autom. Control 45(5), 2000, section III.
    """
    if order < 2:
        raise ContractError(
            f"Gauss-Hermite rule: order is {order}, must be at least 2; one point spreads not"
        )
    if order**size > LARGEST:
        raise ContractError(
            f"Gauss-Hermite rule of order {order} in {size} variables (state and noise "
            f"together) has {order**size} points, at most {LARGEST} are run; use a lower "
            "order, or 'cubature' or 'unscented'"
        )
    nodes, weights = np.polynomial.hermite_e.hermegauss(order)
    nodes[np.abs(nodes) < 1e-12] = 0.0  # the centre, exactly
    points = np.array(list(itertools.product(nodes, repeat=size))).reshape(-1, size)
    shares = np.array(list(itertools.product(weights / weights.sum(), repeat=size)))
    products = shares.prod(axis=1)
    centre = np.flatnonzero((points == 0).all(axis=1))
    if len(centre):
        order_of = np.concatenate([centre, np.delete(np.arange(len(points)), centre)])
        points, products = points[order_of], products[order_of]
    else:
        points = np.concatenate([np.zeros((1, size)), points])
        products = np.concatenate([[0.0], products])
    return Rule(points, products, products)
