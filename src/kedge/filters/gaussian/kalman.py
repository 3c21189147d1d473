"""Kalman filter: for linear models only, and it says so."""

from kedge.core.registry import filters
from kedge.filters.gaussian.recursion import AbstractMomentFilter
from kedge.numerics.propagation import Taylor


@filters.add("kalman")
class Kalman(AbstractMomentFilter):
    r"""The optimal filter of a linear Gaussian model, $x' = F x + G w$, $z = H x + v$.

    A model that is not affine in state and noise is refused with a ``ContractError``: there
    this recursion would be the extended filter under a wrong name.

    Source: R. Kalman, "A new approach to linear filtering and prediction problems", J. Basic
    Eng. 82(1), 1960.
    """

    def strategy(self) -> Taylor:
        """Exact for affine functions."""
        return Taylor(affine_only=True)
