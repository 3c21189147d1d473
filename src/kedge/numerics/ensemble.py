r"""Linear algebra of ensemble filters, in the space where the measurement noise is white.

Everywhere here Y holds the expected measurements' anomalies, one column a member, divided by
$\sqrt{N - 1}$ and by the root of R, and d the mean residual divided by the latter: the
innovation covariance is $I + Y Y^\top$. Factorisations are done in the smaller of ensemble
and measurement space, so nothing is ever formed of the size of the state squared.
"""

import functools as ft
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.contracts import AbstractMeasurementModel, Innovation
from kedge.numerics.linalg import (
    UNROLLED,
    cholesky,
    solve_lower,
    solve_lower_transposed,
    symmetric,
)
from kedge.numerics.localisation import between, gaspari_cohn
from kedge.numerics.random import normals

Move = Callable[[Float[Array, "m k"]], Float[Array, "n k"]]
LOOPED = 128
"""Up to here a triangle is inverted by a loop of kedge's own."""


class Whitened(NamedTuple):
    """What the ensemble expected of a measurement, in units of its noise."""

    residual: Float[Array, " m"]
    spread: Float[Array, "m N"]
    colour: Callable[[Float[Array, "m m"]], Float[Array, "m m"]]
    """Puts a covariance of white components back into the measurement's units."""
    log_det: Float[Array, ""]
    """Of R."""


class Evidence(NamedTuple):
    """How well the residual fits its covariance, in white units."""

    nis: Float[Array, ""]
    log_det: Float[Array, ""]
    """Of the innovation covariance relative to R."""
    cov: Float[Array, "m m"]
    """The innovation covariance. Programs that do not return it do not form it."""


def whiten(
    model: AbstractMeasurementModel,
    mean: Any,
    residual: Float[Array, " m"],
    spread: Float[Array, "m N"],
) -> Whitened:
    """Divide by the root of R at the state ``mean``.

    Correlated noise is divided by its Cholesky factor; a white component then keeps the place
    of the measured component of the same index.
    """
    spread = spread / (spread.shape[1] - 1) ** 0.5
    variance = model.noise_variance(mean)
    if variance is not None:
        std = jnp.sqrt(variance)
        log_det = jnp.sum(jnp.log(variance))
        return Whitened(
            residual / std,
            spread / std[:, None],
            lambda S: std[:, None] * S * std[None],
            log_det,
        )
    root = cholesky(model.noise_cov(mean))
    return Whitened(
        solve_lower(root, residual),
        solve_lower(root, spread),
        lambda S: root @ S @ root.T,
        2 * jnp.sum(jnp.log(jnp.diag(root))),
    )


def innovation_cov(white: Whitened) -> Float[Array, "m m"]:
    r"""$I + Y Y^\top$."""
    Y = white.spread
    return jnp.eye(Y.shape[0], dtype=Y.dtype) + Y @ Y.T


def scored(
    residual: Float[Array, " m"], white: Whitened, evidence: Evidence, dof: Any
) -> Innovation:
    r"""The record of an update, $\log p = -\tfrac12(\epsilon + \log\det S + d \log 2\pi)$."""
    log_det = white.log_det + evidence.log_det
    log_likelihood = -0.5 * (evidence.nis + log_det + dof * jnp.log(2 * jnp.pi))
    cov = symmetric(white.colour(evidence.cov))
    return Innovation(residual, cov, evidence.nis, jnp.asarray(dof), log_likelihood)


class Factor(NamedTuple):
    r"""Cholesky factor of $I + Y Y^\top$, or of $I + Y^\top Y$ if that is smaller.

    Source: G. Evensen, "The ensemble Kalman filter: theoretical formulation and practical
    implementation", Ocean Dynamics 53, 2003; J. Mandel, "Efficient implementation of the
    ensemble Kalman filter", University of Colorado CCM report 231, 2006 (the smaller space).
    """

    white: Whitened
    root: Float[Array, "k k"]

    @property
    def _by_member(self) -> bool:
        measured, count = self.white.spread.shape
        return count < measured

    def regressor(self, anomalies: Float[Array, "n N"]) -> Move:
        r"""$D \mapsto A Y^\top (I + Y Y^\top)^{-1} D$: what white residuals move the state by.

        A is divided by the root of N - 1 as Y is.
        """
        Y = self.white.spread
        if self._by_member:
            solve = _solver(self.root)
            return lambda columns: anomalies @ solve(Y.T @ columns)
        gain = _solver(self.root)(Y @ anomalies.T).T
        return lambda columns: times(gain, columns)

    def evidence(self) -> Evidence:
        """Of the mean residual."""
        d, Y = self.white.residual, self.white.spread
        if self._by_member:
            explained = solve_lower(self.root, d @ Y)
            nis = jnp.maximum(d @ d - explained @ explained, 0.0)
        else:
            white = solve_lower(self.root, d)
            nis = white @ white
        log_det = 2 * jnp.sum(jnp.log(jnp.diag(self.root)))
        return Evidence(nis, log_det, innovation_cov(self.white))


class Tapered(NamedTuple):
    r"""Cholesky factor of $S = I + \rho \circ Y Y^\top$, correlations tapered by distance.

    Source: P. Houtekamer, H. Mitchell, "A sequential ensemble Kalman filter for atmospheric
    data assimilation", Mon. Weather Rev. 129, 2001.
    """

    white: Whitened
    cov: Float[Array, "m m"]
    root: Float[Array, "m m"]
    taper: Float[np.ndarray, "m n"]

    def regressor(self, anomalies: Float[Array, "n N"]) -> Move:
        r"""$D \mapsto (\rho \circ A Y^\top) S^{-1} D$."""
        cross = jnp.asarray(self.taper, anomalies.dtype) * (self.white.spread @ anomalies.T)
        gain = _solver(self.root)(cross).T
        return lambda columns: times(gain, columns)

    def evidence(self) -> Evidence:
        """Of the mean residual."""
        white = solve_lower(self.root, self.white.residual)
        return Evidence(white @ white, 2 * jnp.sum(jnp.log(jnp.diag(self.root))), self.cov)


def regression(
    white: Whitened, distances: Float[np.ndarray, "m n"] | None, radius: float
) -> Factor | Tapered:
    """The regression of the state on the measurement: tapered if there are distances."""
    Y = white.spread
    if distances is not None:
        taper = jnp.asarray(gaspari_cohn(between(distances), radius), Y.dtype)
        cov = jnp.eye(Y.shape[0], dtype=Y.dtype) + taper * (Y @ Y.T)
        return Tapered(white, cov, cholesky(cov), gaspari_cohn(distances, radius))
    square = Y.T @ Y if Y.shape[1] < Y.shape[0] else Y @ Y.T
    return Factor(white, cholesky(jnp.eye(square.shape[0], dtype=Y.dtype) + square))


def times(matrix: Float[Array, "n m"], columns: Float[Array, "m k"]) -> Float[Array, "n k"]:
    """The product; of a small matrix with many columns as a loop over these."""
    if not 0 < matrix.shape[1] <= UNROLLED:
        return matrix @ columns
    terms = (matrix[:, i, None] * columns[i][None] for i in range(matrix.shape[1]))
    return ft.reduce(operator.add, terms)


def _solver(root: Float[Array, "k k"]) -> Callable[[Float[Array, "k n"]], Float[Array, "k n"]]:
    r"""Solves $L L^\top X = B$ for many columns.

    For middling sizes L is inverted row by row: the library splits its substitution among
    threads even there, which on a busy machine takes a hundred times as long.
    """
    size = root.shape[0]
    if not UNROLLED < size <= LOOPED:
        return lambda right: solve_lower_transposed(root, solve_lower(root, right))

    def row(i: Array, inverse: Float[Array, "k k"]) -> Float[Array, "k k"]:
        remainder = (
            jnp.where(jnp.arange(size) == i, 1.0, 0.0).astype(root.dtype) - root[i] @ inverse
        )
        return inverse.at[i].set(remainder / root[i, i])

    inverse = lax.fori_loop(0, size, row, jnp.zeros_like(root))
    return lambda right: inverse.T @ (inverse @ right)


def rotation(key: PRNGKeyArray, count: int, dtype: Any) -> Float[Array, "N N"]:
    """A random orthogonal matrix that leaves the vector of ones, and so the mean, in place.

    Uniform among these: a uniform orthogonal matrix of one dimension less, from the QR
    factorisation of a normal one with the signs made unique, in a basis of the complement.

    Source: P. Sakov, P. Oke, "Implications of the form of the ensemble transformation in the
    ensemble square root filters", Mon. Weather Rev. 136, 2008, section 5; F. Mezzadri, "How to
    generate random matrices from the classical compact groups", Notices AMS 54, 2007.
    """
    normal = np.full(count, -(count**-0.5))
    normal[0] += 1.0
    reflection = np.eye(count) - 2 * np.outer(normal, normal) / (normal @ normal)
    basis = jnp.asarray(reflection[:, 1:], dtype)
    q, r = jnp.linalg.qr(normals(key, (count - 1, count - 1), dtype))
    turned = q * jnp.where(jnp.diag(r) < 0, -1.0, 1.0)[None]
    return jnp.full((count, count), 1 / count, dtype) + basis @ turned @ basis.T
