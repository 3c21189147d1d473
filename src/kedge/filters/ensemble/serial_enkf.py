"""Serial square root filter: one measured component after the other."""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.registry import filters
from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.numerics.ensemble import Evidence, Whitened, innovation_cov
from kedge.numerics.localisation import between, gaspari_cohn


@filters.add("serial-enkf")
class SerialEnsembleKalman(AbstractEnsembleFilter):
    r"""Potter's square root update for each white component of the measurement in turn.

    With $y$ its anomalies, $s = y^\top y$, $\delta$ its residual and $k = A y / (1 + s)$:
    $\bar x^+ = \bar x + k \delta$, $A^+ = A - k y^\top / (1 + 1 / \sqrt{1 + s})$; the
    components still to come are updated in the same way. Correlated noise is whitened first.

    Mean and covariance are those of ``etkf``; the members differ. No matrix is decomposed,
    and with a ``radius`` each k is tapered by its own component's distances.

    Source: J. Whitaker, T. Hamill, "Ensemble data assimilation without perturbed
    observations", Mon. Weather Rev. 130, 2002; J. Potter in R. Battin, "Astronautical
    Guidance", 1964 (the square root).
    """

    def analyse(
        self,
        white: Whitened,
        anomalies: Float[Array, "n N"],
        distances: Float[np.ndarray, "m n"] | None,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, " n"], Float[Array, "n N"], Evidence]:
        """Sweep over the components in their order."""
        del key
        size, count = anomalies.shape
        measured = white.spread.shape[0]
        if distances is None and count < size + measured:
            weights, transform, nis, log_det = _in_ensemble_space(white)
            shift, updated = anomalies @ weights, anomalies @ transform.T
        else:
            joint = jnp.concatenate([anomalies, white.spread])
            taper = None
            if distances is not None:
                both = np.concatenate([distances, between(distances)], axis=1)
                taper = jnp.asarray(gaspari_cohn(both, self.radius), joint.dtype)
            shift, updated, nis, log_det = _jointly(joint, white.residual, taper)
        return shift, updated, Evidence(nis, log_det, innovation_cov(white))


def _in_ensemble_space(white: Whitened) -> tuple[Array, Array, Array, Array]:
    """The sweep on combinations of the first anomalies: weights of the mean, transform."""
    d, Y = white.residual, white.spread
    zero = jnp.zeros((), d.dtype)

    def component(j, carry):
        weights, T, nis, log_det = carry
        y = T @ Y[j]
        gap, total = d[j] - weights @ Y[j], 1 + y @ y
        back = y @ T
        weights = weights + back * (gap / total)
        T = T - jnp.outer(y / (total + jnp.sqrt(total)), back)
        return weights, T, nis + gap**2 / total, log_det + jnp.log(total)

    count = Y.shape[1]
    start = jnp.zeros(count, d.dtype), jnp.eye(count, dtype=d.dtype), zero, zero
    return lax.fori_loop(0, Y.shape[0], component, start)


def _jointly(
    joint: Float[Array, "k N"], residual: Float[Array, " m"], taper: Array | None
) -> tuple[Array, Array, Array, Array]:
    """The sweep on state and expected measurement side by side, one row a component."""
    measured = residual.shape[0]
    size = joint.shape[0] - measured
    zero = jnp.zeros((), joint.dtype)

    def component(j, carry):
        joint, shift, nis, log_det = carry
        y = joint[size + j]
        gap, total = residual[j] - shift[size + j], 1 + y @ y
        gain = joint @ y / total
        if taper is not None:
            gain = gain * taper[j]
        joint = joint - jnp.outer(gain, y / (1 + 1 / jnp.sqrt(total)))
        return joint, shift + gain * gap, nis + gap**2 / total, log_det + jnp.log(total)

    start = joint, jnp.zeros(joint.shape[0], joint.dtype), zero, zero
    joint, shift, nis, log_det = lax.fori_loop(0, measured, component, start)
    return shift[:size], joint[:size], nis, log_det
