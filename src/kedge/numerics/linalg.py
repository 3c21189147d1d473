"""Dense linear algebra of the Gaussian filters.

Matrices of up to :data:`UNROLLED` rows are factorised by loops that tracing unrolls: for the
3 to 8 components of a vehicle's state that is faster than a library call, alone and in
batches, and it is straight-line code. Nothing else in kedge knows this.
"""

import jax.numpy as jnp
from jax.scipy.linalg import cholesky as library_cholesky
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

UNROLLED = 8


def symmetric(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Remove the antisymmetric part that rounding leaves."""
    return (matrix + matrix.T) / 2


def cholesky(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower triangular L with ``L @ L.T == matrix``; NaN where it is not positive definite."""
    if matrix.shape[0] > UNROLLED:
        return library_cholesky(matrix, lower=True)
    return _factorise(matrix, rounding=None)


def square_root(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower triangular L with ``L @ L.T == matrix``, also where it is only semi-definite.

    A pivot that vanishes to rounding leaves a column of zeros: what is known exactly does not
    spread. NaN where a pivot is negative beyond rounding, which the pivots before it amplify.
    """
    size = matrix.shape[0]
    rounding = 16 * size * float(jnp.finfo(matrix.dtype).eps)
    if size <= UNROLLED:
        return _factorise(matrix, rounding)
    columns = jnp.zeros((size, 0), matrix.dtype)
    for j in range(size):
        column = matrix[:, j] - columns @ columns[j]
        scale = _inverse_root(column[j], matrix[j, j], rounding)
        below = jnp.where(jnp.arange(size) < j, 0.0, column * scale)
        columns = jnp.concatenate([columns, below[:, None]], axis=1)
    return columns


def solve_lower(
    root: Float[Array, "n n"], right: Float[Array, "n ..."]
) -> Float[Array, "n ..."]:
    """Solve ``root @ x = right`` for a lower triangular ``root``."""
    size = root.shape[0]
    if size > UNROLLED:
        return solve_triangular(root, right, lower=True)
    rows: list[Array] = []
    for i in range(size):
        value = right[i]
        for k in range(i):
            value = value - root[i, k] * rows[k]
        rows.append(value / root[i, i])
    return jnp.stack(rows)


def solve_lower_transposed(
    root: Float[Array, "n n"], right: Float[Array, "n ..."]
) -> Float[Array, "n ..."]:
    """Solve ``root.T @ x = right`` for a lower triangular ``root``."""
    size = root.shape[0]
    if size > UNROLLED:
        return solve_triangular(root, right, lower=True, trans=1)
    rows: dict[int, Array] = {}
    for i in reversed(range(size)):
        value = right[i]
        for k in range(i + 1, size):
            value = value - root[k, i] * rows[k]
        rows[i] = value / root[i, i]
    return jnp.stack([rows[i] for i in range(size)])


def gain(cross: Float[Array, "n m"], root: Float[Array, "m m"]) -> Float[Array, "n m"]:
    """Solve ``K @ cov = cross``, given the Cholesky factor ``root`` of ``cov``."""
    return solve_lower_transposed(root, solve_lower(root, cross.T)).T


def _factorise(matrix: Float[Array, "n n"], rounding: float | None) -> Float[Array, "n n"]:
    size = matrix.shape[0]
    root: list[list[Array]] = [[jnp.zeros(())] * size for _ in range(size)]
    for j in range(size):
        pivot = matrix[j, j] - sum((root[j][k] ** 2 for k in range(j)), jnp.zeros(()))
        if rounding is None:
            root[j][j] = jnp.sqrt(pivot)
            inverse = 1 / root[j][j]
        else:
            inverse = _inverse_root(pivot, matrix[j, j], rounding)
            root[j][j] = pivot * inverse
        for i in range(j + 1, size):
            rest = sum((root[i][k] * root[j][k] for k in range(j)), jnp.zeros(()))
            root[i][j] = (matrix[i, j] - rest) * inverse
    return _assemble(root, size)


def _inverse_root(
    pivot: Float[Array, ""], variance: Float[Array, ""], rounding: float
) -> Float[Array, ""]:
    vanishes = (pivot <= rounding * variance) & (pivot >= -(rounding**0.5) * variance)
    return jnp.where(vanishes, 0.0, 1 / jnp.sqrt(jnp.where(vanishes, 1.0, pivot)))


def _assemble(rows: list[list[Array]], size: int) -> Float[Array, "n n"]:
    return jnp.stack([jnp.stack(row) for row in rows]) if size else jnp.zeros((0, 0))
