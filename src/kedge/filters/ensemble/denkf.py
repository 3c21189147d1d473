"""Deterministic ensemble Kalman filter of Sakov and Oke."""

import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.registry import filters
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.numerics.ensemble import Evidence, Whitened, regression


@filters.add("denkf")
class DeterministicEnsembleKalman(AbstractEnsembleFilter):
    r"""Half the gain on the anomalies: $A^+ = A - \tfrac12 K H A$, the mean with all of it.

    The covariance is the Kalman filter's plus $\tfrac14 K H P H^\top K^\top$, close to it
    where the correction is small, and never below it; so it needs less inflation than the
    others. With a ``radius`` sample correlations are tapered.

    Source: P. Sakov, P. Oke, "A deterministic formulation of the ensemble Kalman filter: an
    alternative to ensemble square root filters", Tellus 60A, 2008, section 2.
    """

    def analyse(
        self,
        white: Whitened,
        anomalies: Float[Array, "n N"],
        distances: Float[np.ndarray, "m n"] | None,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, " n"], Float[Array, "n N"], Evidence]:
        """Regress the mean residual, and the anomalies by half."""
        del key
        solved = regression(white, distances, self.radius)
        move = solved.regressor(anomalies)
        updated = anomalies - move(white.spread / 2)
        return move(white.residual[:, None])[:, 0], updated, solved.evidence()
