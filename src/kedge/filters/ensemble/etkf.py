"""Ensemble transform Kalman filter."""

from jaxtyping import Array, Float

from kedge.core.registry import filters
from kedge.filters.ensemble.transform import AbstractTransform
from kedge.numerics.gram import Gram


@filters.add("etkf")
class EnsembleTransformKalman(AbstractTransform):
    r"""Deterministic filter with the symmetric square root, the usual choice of the family.

    Its update is the Kalman filter's for the sample moments: exactly so for a linear
    measurement and more members than dimensions.

    Source: C. Bishop, B. Etherton, S. Majumdar, "Adaptive sampling with the ensemble transform
    Kalman filter. Part I", Mon. Weather Rev. 129, 2001; E. Ott et al., "A local ensemble
    Kalman filter for atmospheric data assimilation", Tellus 56A, 2004 (symmetric root).
    """

    def prior_inflation(
        self, eigen: Gram, squares: Float[Array, " k"]
    ) -> Float[Array, ""] | float:
        """None."""
        del eigen, squares
        return 1.0
