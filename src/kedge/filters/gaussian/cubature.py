"""Cubature Kalman filter: the sigma points that need no parameters."""

from kedge.core.registry import filters
from kedge.filters.gaussian.recursion import AbstractMomentFilter
from kedge.numerics.propagation import SigmaPoints
from kedge.numerics.quadrature import cubature


@filters.add("cubature")
class CubatureKalman(AbstractMomentFilter):
    r"""Sigma points at $\pm\sqrt n$ along each axis, all of the same positive weight.

    Exact for polynomials of third degree, and covariances stay positive semi-definite in any
    dimension. Beside the unscented filter with its defaults the points lie a little nearer.

    Source: I. Arasaratnam and S. Haykin, "Cubature Kalman filters", IEEE Trans. Autom.
    Control 54(6), 2009.
    """

    def strategy(self) -> SigmaPoints:
        """The third-degree spherical-radial rule."""
        return SigmaPoints(cubature)
