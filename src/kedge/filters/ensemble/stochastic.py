"""Stochastic ensemble Kalman filter."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.registry import filters
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.numerics.ensemble import Evidence, Whitened, regression
from kedge.numerics.random import normals


@filters.add("ensemble")
class EnsembleKalman(AbstractEnsembleFilter):
    r"""Every member is moved towards its own perturbed copy of the measurement.

    $x_i^+ = x_i + K (z + v_i - h(x_i))$ with $v_i \sim N(0, R)$ and the gain from sample
    covariances and the exact R. With ``centred`` the perturbations have mean zero, so that
    the ensemble's mean is moved by the measurement alone; their sample covariance has the
    expectation R as it is, so they are not stretched. With a ``radius`` sample correlations are
    tapered.

    Source: G. Burgers, P. van Leeuwen, G. Evensen, "Analysis scheme in the ensemble Kalman
    filter", Mon. Weather Rev. 126, 1998.
    """

    centred: bool = eqx.field(static=True, default=True)

    def analyse(
        self,
        white: Whitened,
        anomalies: Float[Array, "n N"],
        distances: Float[np.ndarray, "m n"] | None,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, " n"], Float[Array, "n N"], Evidence]:
        """Regress every member's own residual."""
        solved = regression(white, distances, self.radius)
        normal = (self.count - 1) ** 0.5
        noise = normals(key, white.spread.shape, white.spread.dtype) / normal
        move = solved.regressor(anomalies)
        shift = move(white.residual[:, None])[:, 0]
        updated = anomalies + move(noise - white.spread)
        drift = jnp.mean(updated, axis=1)
        # All that perturbations centred before would change is this mean.
        shift = shift if self.centred else shift + drift * normal
        return shift, updated - drift[:, None], solved.evidence()
