"""Ensemble transform filters: the anomalies are combined by a symmetric square root."""

import abc

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.filters.ensemble.recursion import AbstractEnsembleFilter
from kedge.numerics.ensemble import Evidence, Whitened, innovation_cov
from kedge.numerics.gram import Gram, gram
from kedge.numerics.localisation import neighbourhoods


class AbstractTransform(AbstractEnsembleFilter):
    r"""$\bar x^+ = \bar x + A w,\quad A^+ = A (I + Y^\top Y)^{-1/2}$.

    $w = (I + Y^\top Y)^{-1} Y^\top d$, with everything white and normalised as in
    :mod:`kedge.numerics.ensemble`. Among all square roots the symmetric one keeps the mean of
    the anomalies zero and moves the members least.

    With a ``radius`` every component of the state has an analysis of its own, from the
    measured components around it, their precision tapered with distance. What is reported
    of the innovation is that of the whole ensemble, without localisation.

    Source: C. Bishop, B. Etherton, S. Majumdar, "Adaptive sampling with the ensemble transform
    Kalman filter. Part I", Mon. Weather Rev. 129, 2001; B. Hunt, E. Kostelich, I. Szunyogh,
    "Efficient data assimilation for spatiotemporal chaos: a local ensemble transform Kalman
    filter", Physica D 230, 2007 (symmetric root, localisation).
    """

    @abc.abstractmethod
    def prior_inflation(
        self, eigen: Gram, squares: Float[Array, " k"]
    ) -> Float[Array, ""] | float:
        """What the prior anomalies are multiplied by.

        ``squares`` are those of the residual's coordinates along the spectrum.
        """

    def analyse(
        self,
        white: Whitened,
        anomalies: Float[Array, "n N"],
        distances: Float[np.ndarray, "m n"] | None,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, " n"], Float[Array, "n N"], Evidence]:
        """Transform all components alike, or each with its own neighbourhood."""
        del key
        if distances is None:
            eigen = gram(white.spread)
            shift, updated = self._transformed(eigen, white.residual, anomalies)
            return shift, updated, _evidence(eigen, white)

        near = neighbourhoods(distances, self.radius)
        weights = jnp.asarray(np.sqrt(near.weight), white.spread.dtype)

        def local(index, weight, row):
            eigen = gram(white.spread[index] * weight[:, None])
            shift, updated = self._transformed(eigen, white.residual[index] * weight, row[None])
            return shift[0], updated[0]

        shift, updated = jax.vmap(local)(jnp.asarray(near.places), weights, anomalies)
        # One decomposition after the other: batches of them at once can lock up the CPU's pool.
        spread, shift, updated = lax.optimization_barrier((white.spread, shift, updated))
        return shift, updated, _evidence(gram(spread), white)

    def _transformed(
        self, eigen: Gram, residual: Float[Array, " m"], anomalies: Float[Array, "n N"]
    ) -> tuple[Float[Array, " n"], Float[Array, "n N"]]:
        squares, _ = _coordinates(eigen, residual)
        inflation = self.prior_inflation(eigen, squares)
        eigen, anomalies = eigen.scaled(inflation), anomalies * inflation
        weights = eigen.pulled(lambda v: 1 / (1 + v), residual[None])[0]
        updated = eigen.applied(
            lambda v: 1 / jnp.sqrt(1 + v),
            lambda v: -1 / (jnp.sqrt(1 + v) * (1 + jnp.sqrt(1 + v))),
            anomalies,
        )
        return anomalies @ weights, updated


def _coordinates(
    eigen: Gram, residual: Float[Array, " m"]
) -> tuple[Float[Array, " k"], Float[Array, ""]]:
    """The residual's squared coordinates along the spectrum, and the square of the rest."""
    if not eigen.by_column:
        return (eigen.vectors.T @ residual) ** 2, jnp.zeros((), residual.dtype)
    along = (eigen.vectors.T @ (residual @ eigen.factor)) ** 2
    informative = eigen.rank() > 0
    squares = jnp.where(informative, along / jnp.where(informative, eigen.values, 1.0), 0.0)
    return squares, jnp.maximum(residual @ residual - jnp.sum(squares), 0.0)


def _evidence(eigen: Gram, white: Whitened) -> Evidence:
    squares, outside = _coordinates(eigen, white.residual)
    nis = outside + jnp.sum(squares / (1 + eigen.values))
    return Evidence(nis, jnp.sum(jnp.log1p(eigen.values)), innovation_cov(white))
