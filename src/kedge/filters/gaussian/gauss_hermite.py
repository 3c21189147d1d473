"""Gauss-Hermite Kalman filter: moments to any order, at a price that grows with the state."""

import functools as ft

import equinox as eqx

from kedge.core.registry import filters
from kedge.filters.gaussian.recursion import AbstractMomentFilter
from kedge.numerics.propagation import SigmaPoints
from kedge.numerics.quadrature import gauss_hermite


@filters.add("gauss-hermite")
class GaussHermiteKalman(AbstractMomentFilter):
    r"""A grid of ``order`` points along each axis: exact to degree $2p - 1$ in each variable.

    $p^{n+w}$ points for n states and w noises, so it is for small states; one that needs too
    many points is refused with a ``ContractError`` that says how many.

    Source: K. Ito and K. Xiong, "Gaussian filters for nonlinear filtering problems", IEEE
    Trans. Autom. Control 45(5), 2000.
    """

    order: int = eqx.field(static=True, default=3)

    def __check_init__(self):
        gauss_hermite(1, self.order)

    def strategy(self) -> SigmaPoints:
        """The tensor rule."""
        return SigmaPoints(ft.partial(gauss_hermite, order=self.order))
