"""Unscented Kalman filter with noise-augmented sigma points on the state's manifold."""

import functools as ft

import equinox as eqx

from kedge.core.registry import filters
from kedge.filters.gaussian import AbstractMomentFilter
from kedge.numerics.propagation import SigmaPoints
from kedge.numerics.quadrature import unscented


@filters.add("unscented")
class UnscentedKalman(AbstractMomentFilter):
    r"""Sigma points at $\pm\sqrt{n + \lambda}$, $\lambda = \alpha^2 (n + \kappa) - n$.

    With the defaults (alpha 1, beta 0, kappa 1) all weights are positive, so that covariances
    stay positive semi-definite. alpha 1e-3, beta 2, kappa 0 are the values often quoted for
    the scaled form; their centre weight is about -1e6.

    Source: S. Julier and J. Uhlmann, "Unscented filtering and nonlinear estimation", Proc.
    IEEE 92(3), 2004; E. Wan and R. van der Merwe, "The unscented Kalman filter for nonlinear
    estimation", AS-SPCC, 2000.
    """

    alpha: float = eqx.field(static=True, default=1.0)
    beta: float = eqx.field(static=True, default=0.0)
    kappa: float = eqx.field(static=True, default=1.0)

    def __check_init__(self):
        unscented(1, self.alpha, self.beta, self.kappa)

    def strategy(self) -> SigmaPoints:
        """The scaled unscented rule."""
        return SigmaPoints(
            ft.partial(unscented, alpha=self.alpha, beta=self.beta, kappa=self.kappa)
        )
