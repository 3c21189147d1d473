r"""Functions of $Y^\top Y$ for tall or wide Y, decomposed in the smaller of its two spaces."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


class Gram(NamedTuple):
    r"""Eigenvalues and vectors of $Y^\top Y$, or of $Y Y^\top$ where that is smaller.

    The eigenvalues that differ from zero are the same.
    """

    factor: Float[Array, "m N"]
    values: Float[Array, " k"]
    vectors: Float[Array, "k k"]

    @property
    def by_column(self) -> bool:
        """Whether the vectors belong to the columns of Y."""
        height, count = self.factor.shape
        return count <= height

    def scaled(self, scale: Float[Array, ""] | float) -> "Gram":
        """That of Y multiplied by ``scale``."""
        return Gram(self.factor * scale, self.values * scale**2, self.vectors)

    def applied(
        self,
        function: Callable[[Array], Array],
        slope: Callable[[Array], Array],
        columns: Float[Array, "k N"],
    ) -> Float[Array, "k N"]:
        r"""$X f(Y^\top Y)$ for $f(0) = 1$, with ``slope`` $= (f(l) - 1) / l$."""
        if self.by_column:
            weighted = self.vectors * function(self.values)[None]
            if columns.shape[0] > columns.shape[1]:
                return columns @ (weighted @ self.vectors.T)
            return (columns @ weighted) @ self.vectors.T
        across = self.vectors.T @ self.factor
        return columns + ((columns @ across.T) * slope(self.values)[None]) @ across

    def pulled(
        self, function: Callable[[Array], Array], left: Float[Array, "k m"]
    ) -> Float[Array, "k N"]:
        r"""$X Y f(Y^\top Y)$, which is $X f(Y Y^\top) Y$."""
        inner = left @ self.factor if self.by_column else left
        inner = ((inner @ self.vectors) * function(self.values)[None]) @ self.vectors.T
        return inner if self.by_column else inner @ self.factor

    def rank(self) -> Float[Array, " k"]:
        """1 for the eigenvalues that are more than rounding, 0 for the others."""
        rounding = 16 * max(self.factor.shape) * float(jnp.finfo(self.values.dtype).eps)
        return jnp.where(self.values > rounding * jnp.max(self.values), 1.0, 0.0)


def gram(factor: Float[Array, "m N"]) -> Gram:
    """Decompose in the smaller space."""
    height, count = factor.shape
    square = factor.T @ factor if count <= height else factor @ factor.T
    values, vectors = jnp.linalg.eigh(square)
    return Gram(factor, jnp.maximum(values, 0.0), vectors)
