"""Points and weights that integrate a standard normal: the rules behind sigma-point filters."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.errors import ContractError


class Rule(NamedTuple):
    """Points for a standard normal, the centre first."""

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
