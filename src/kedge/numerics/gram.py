r"""Functions of $Y Y^\top$ for tall or wide Y, decomposed in the smaller of its two spaces."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


class Gram(NamedTuple):
    r"""Eigenvalues and vectors of $Y Y^\top$, or of $Y^\top Y$ where that is smaller.

    The eigenvalues that differ from zero are the same.
    """

    factor: Float[Array, "N m"]
    values: Float[Array, " k"]
    vectors: Float[Array, "k k"]

    @property
    def by_row(self) -> bool:
        """Whether the vectors belong to the rows of Y."""
        count, width = self.factor.shape
        return count <= width

    def scaled(self, scale: Float[Array, ""] | float) -> "Gram":
        """That of Y multiplied by ``scale``."""
        return Gram(self.factor * scale, self.values * scale**2, self.vectors)

    def applied(
        self,
        function: Callable[[Array], Array],
        slope: Callable[[Array], Array],
        rows: Float[Array, "N k"],
    ) -> Float[Array, "N k"]:
        r"""$f(Y Y^\top) X$ for $f(0) = 1$, with ``slope`` $= (f(l) - 1) / l$."""
        if self.by_row:
            weighted = self.vectors * function(self.values)[None]
            if rows.shape[1] > rows.shape[0]:
                return (weighted @ self.vectors.T) @ rows
            return weighted @ (self.vectors.T @ rows)
        across = self.factor @ self.vectors
        return rows + across @ (slope(self.values)[:, None] * (across.T @ rows))

    def pushed(
        self, function: Callable[[Array], Array], right: Float[Array, "m k"]
    ) -> Float[Array, "N k"]:
        r"""$f(Y Y^\top) Y X$, which is $Y f(Y^\top Y) X$."""
        inner = self.factor @ right if self.by_row else right
        inner = self.vectors @ (function(self.values)[:, None] * (self.vectors.T @ inner))
        return inner if self.by_row else self.factor @ inner

    def rank(self) -> Float[Array, " k"]:
        """1 for the eigenvalues that are more than rounding, 0 for the others."""
        rounding = 16 * max(self.factor.shape) * float(jnp.finfo(self.values.dtype).eps)
        return jnp.where(self.values > rounding * jnp.max(self.values), 1.0, 0.0)


def gram(factor: Float[Array, "N m"]) -> Gram:
    """Decompose in the smaller space."""
    count, width = factor.shape
    square = factor @ factor.T if count <= width else factor.T @ factor
    values, vectors = jnp.linalg.eigh(square)
    return Gram(factor, jnp.maximum(values, 0.0), vectors)
