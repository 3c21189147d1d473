"""Dense linear algebra of the Gaussian filters.

Matrices of up to :data:`UNROLLED` rows are factorised by loops that tracing unrolls: for the
3 to 8 components of a vehicle's state that is faster than a library call, alone and in
batches, and it is straight-line code. Nothing else in kedge knows this. Every function
computes in the precision of its arguments.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import cholesky as library_cholesky
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

UNROLLED = 8
UNROLLED_COLUMNS = 32
"""Up to so many rows a semi-definite matrix is factorised by a loop that tracing unrolls."""


def symmetric(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Remove the antisymmetric part that rounding leaves."""
    return (matrix + matrix.T) / 2


def mirrored(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The lower triangle on both sides, of what is symmetric but for rounding.

    Scalar by scalar compiled, the upper triangle is then not even computed.
    """
    lower = np.tri(matrix.shape[0], dtype=bool)
    return jnp.where(lower, matrix, matrix.T)


def cholesky(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower triangular L with ``L @ L.T == matrix``; NaN where it is not positive definite."""
    if matrix.shape[0] > UNROLLED:
        return library_cholesky(matrix, lower=True)
    return _factorise(matrix)


def square_root(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower triangular L with ``L @ L.T == matrix``, also where it is only semi-definite.

    A pivot that vanishes to rounding leaves a column of zeros: what is known exactly does not
    spread. NaN where a pivot is negative beyond rounding, which the pivots before it amplify.
    """
    return _semidefinite(matrix, clip=False)[0]


def definite(matrix: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], Int[Array, ""]]:
    """The matrix with its negative pivots clipped to zero, and how many had to be.

    With none the matrix itself comes back, to the bit. What is not finite stays so, and is not
    counted: a repair mends indefiniteness, not errors.
    """
    root, clipped = _semidefinite(matrix, clip=True)
    clipped = jnp.where(jnp.isfinite(matrix).all(), clipped, 0)
    return jnp.where(clipped > 0, root @ root.T, matrix), clipped


def triangularise(rows: Float[Array, "m k"]) -> Float[Array, "m m"]:
    r"""Lower triangular L with ``L @ L.T == rows @ rows.T``, formed without the product.

    The rows are made orthogonal one after the other (modified Gram-Schmidt), so
    $A = L Q$ with orthonormal rows in Q, which is not kept. A row that depends on those before
    it leaves a column of zeros. The diagonal is not negative.

    Source: Å. Björck, "Numerical Methods for Least Squares Problems", 1996, section 2.4: the
    triangular factor of modified Gram-Schmidt is as accurate as Householder's.
    """
    size = rows.shape[0]
    if size > 2 * UNROLLED:  # a state and a measurement of UNROLLED components each
        short = max(size - rows.shape[1], 0)
        upper = jnp.linalg.qr(jnp.pad(rows, ((0, 0), (0, short))).T, mode="r")
        signs = jnp.where(jnp.diag(upper) < 0, -1, 1).astype(rows.dtype)
        return (signs[:, None] * upper).T
    columns: list[Array] = []
    for i in range(size):
        squared = rows[0] @ rows[0]
        length = jnp.sqrt(squared)
        inverse = jnp.where(squared == 0, 0, 1 / jnp.where(squared == 0, 1, length))
        unit = rows[0] * inverse
        below = rows[1:] @ unit
        rows = rows[1:] - below[:, None] * unit[None]
        columns.append(jnp.concatenate([jnp.zeros(i, rows.dtype), length[None], below]))
    return jnp.stack(columns, axis=1) if size else jnp.zeros((0, 0), rows.dtype)


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
        rows.append(value * (1 / root[i, i]))  # the factorisation has that inverse already
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
        rows[i] = value * (1 / root[i, i])
    return jnp.stack([rows[i] for i in range(size)])


def gain(cross: Float[Array, "n m"], root: Float[Array, "m m"]) -> Float[Array, "n m"]:
    """Solve ``K @ cov = cross``, given the Cholesky factor ``root`` of ``cov``."""
    return solve_lower_transposed(root, solve_lower(root, cross.T)).T


def _factorise(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    size, zero = matrix.shape[0], jnp.zeros((), matrix.dtype)
    root: list[list[Array]] = [[zero] * size for _ in range(size)]
    for j in range(size):
        root[j][j] = jnp.sqrt(matrix[j, j] - sum((root[j][k] ** 2 for k in range(j)), zero))
        inverse = 1 / root[j][j]
        for i in range(j + 1, size):
            projected = sum((root[i][k] * root[j][k] for k in range(j)), zero)
            root[i][j] = (matrix[i, j] - projected) * inverse
    return _assemble(root, matrix)


def _semidefinite(
    matrix: Float[Array, "n n"], clip: bool
) -> tuple[Float[Array, "n n"], Int[Array, ""]]:
    """Factorise with vanishing pivots; with ``clip``, negative ones vanish and are counted."""
    size, zero = matrix.shape[0], jnp.zeros((), matrix.dtype)
    rounding = 16 * size * float(jnp.finfo(matrix.dtype).eps)

    def inverse_of(pivot: Array, variance: Array) -> tuple[Array, Array]:
        """Inverse root of a pivot, 0 where it vanishes; and whether it was negative."""
        negative = pivot < -(rounding**0.5) * jnp.abs(variance)
        vanishes = pivot <= rounding * jnp.abs(variance)
        vanishes = vanishes if clip else vanishes & ~negative
        return jnp.where(vanishes, 0, 1 / jnp.sqrt(jnp.where(vanishes, 1, pivot))), negative

    def column_of(j: Array | int, columns: Array) -> tuple[Array, Array]:
        remainder = matrix[:, j] - columns @ columns[j]
        inverse, negative = inverse_of(remainder[j], matrix[j, j])
        return jnp.where(jnp.arange(size) < j, zero, remainder * inverse), negative

    clipped = jnp.zeros((), int)
    if size > UNROLLED:

        def eliminate(j: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            column, negative = column_of(j, carry[0])
            return carry[0].at[:, j].set(column), carry[1] + negative

        none = jnp.zeros_like(matrix), clipped
        library = library_cholesky(lax.stop_gradient(matrix), lower=True)
        regular = jnp.all(jnp.diag(library) ** 2 > rounding * jnp.diag(matrix))
        if size <= UNROLLED_COLUMNS:
            return lax.cond(
                regular,
                # Anew, since where it fails even a derivative that nobody takes is NaN.
                lambda: (library_cholesky(matrix, lower=True), clipped),
                lambda: lax.fori_loop(0, size, eliminate, none),
            )
        # No steps rather than a branch: in a batch, both sides of a branch would be computed.
        start = jnp.where(regular, library_cholesky(matrix, lower=True), none[0]), clipped
        return lax.fori_loop(0, jnp.where(regular, 0, size), eliminate, start)
    root: list[list[Array]] = [[zero] * size for _ in range(size)]
    for j in range(size):
        pivot = matrix[j, j] - sum((root[j][k] ** 2 for k in range(j)), zero)
        inverse, negative = inverse_of(pivot, matrix[j, j])
        root[j][j], clipped = pivot * inverse, clipped + negative
        for i in range(j + 1, size):
            projected = sum((root[i][k] * root[j][k] for k in range(j)), zero)
            root[i][j] = (matrix[i, j] - projected) * inverse
    return _assemble(root, matrix), clipped


def _assemble(rows: list[list[Array]], like: Float[Array, "n n"]) -> Float[Array, "n n"]:
    return jnp.stack([jnp.stack(row) for row in rows]) if rows else jnp.zeros_like(like)
