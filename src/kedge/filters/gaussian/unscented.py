"""Unscented Kalman filter with noise-augmented sigma points on the state's manifold."""

import functools as ft

import equinox as eqx

from kedge.core.registry import filters
from kedge.filters.gaussian.recursion import AbstractMomentFilter
from kedge.numerics.propagation import SigmaPoints
from kedge.numerics.quadrature import least_size, unscented


@filters.add("unscented")
class UnscentedKalman(AbstractMomentFilter):
    r"""Sigma points at $\pm\sqrt{n + \lambda}$, $\lambda = \alpha^2 (n + \kappa) - n$.

    ``alpha`` pulls the points towards the mean, ``kappa`` sets their distance in states of
    one component (2 fits a Gaussian's fourth moment there), ``beta`` adds to the weight of the
    centre in covariances (2 is best for a Gaussian seen through a quadratic).

    With the defaults (alpha 1, beta 0, kappa 1) all weights are positive, so that covariances
    stay positive semi-definite. alpha 1e-3, beta 2, kappa 0 are the values often quoted for
    the scaled form; their centre weight is about -1e6. A covariance that negative weights make
    indefinite is repaired, and the next innovation says how many pivots had to be lifted.

    The noise of a step is among the variables that the points span, and each update draws new
    ones from the prediction. Textbooks that add the covariance of the noise instead, or keep
    the propagated points for the update, get other figures, from the third digit on, where a
    model is nonlinear: those of the filter "additive-unscented".

    Source: S. Julier and J. Uhlmann, "Unscented filtering and nonlinear estimation", Proc.
    IEEE 92(3), 2004; E. Wan and R. van der Merwe, "The unscented Kalman filter for nonlinear
    estimation", AS-SPCC, 2000.
    """

    alpha: float = eqx.field(static=True, default=1.0)
    beta: float = eqx.field(static=True, default=0.0)
    kappa: float = eqx.field(static=True, default=1.0)

    def __check_init__(self):
        unscented(least_size(self.kappa), self.alpha, self.beta, self.kappa)

    def strategy(self) -> SigmaPoints:
        """The scaled unscented rule."""
        # The centre's weight 1 - n / (alpha^2 (n + kappa)) is monotone in n.
        least = least_size(self.kappa)
        ends = (least / (least + self.kappa), 1.0)
        lowest = min(1 - end / self.alpha**2 for end in ends) + 1 - self.alpha**2 + self.beta
        return SigmaPoints(
            ft.partial(unscented, alpha=self.alpha, beta=self.beta, kappa=self.kappa),
            negative=lowest < 0,
        )
