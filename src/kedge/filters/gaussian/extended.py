"""Extended Kalman filter on the state's manifold (the error-state form)."""

from kedge.core.registry import filters
from kedge.filters.gaussian.recursion import AbstractMomentFilter
from kedge.numerics.propagation import Taylor


@filters.add("extended")
class ExtendedKalman(AbstractMomentFilter):
    """First-order filter: the model is linearised at the mean, in its tangent space.

    Source: J. Solà, "Quaternion kinematics for the error-state Kalman filter", 2017,
    arXiv 1711.02508, chapter 6.
    """

    def strategy(self) -> Taylor:
        """First order about the mean."""
        return Taylor()
