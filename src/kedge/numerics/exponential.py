"""Matrix exponentials in straight-line code, for steps of linear systems."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.quantities import Scalar

HALVINGS, ORDER = 6, 10


def held_inputs(
    A: Float[Array, "n n"], B: Float[Array, "n m"], dt: Scalar
) -> tuple[Float[Array, "n n"], Float[Array, "n m"]]:
    r"""F and G of $x' = F x + G u$ for $\dot x = A x + B u$ with u held over ``dt``.

    $\begin{pmatrix} F & G \\ 0 & I \end{pmatrix} = \exp \begin{pmatrix} A & B \\ 0 & 0
    \end{pmatrix} \Delta t$ by scaling and squaring of a Taylor polynomial: exact to rounding
    while $\lVert A \rVert \Delta t$ is below about 8.

    Source: C. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans.
    Automatic Control 23(3), 1978; C. Moler, C. Van Loan, "Nineteen dubious ways to compute
    the exponential of a matrix, twenty-five years later", SIAM Review 45(1), 2003, method 3.
    """
    size = A.shape[0]
    A, h = A * dt, dt / 2**HALVINGS
    small = A / 2**HALVINGS
    # F - I, which keeps its digits while it is small, and the integral of the exponential.
    term, increment, integral = jnp.eye(size), jnp.zeros((size, size)), jnp.eye(size)
    for k in range(1, ORDER + 1):
        term = small @ term / k
        increment = increment + term
        integral = integral + term / (k + 1)
    integral = integral * h
    for _ in range(HALVINGS):
        integral = integral + integral @ (increment + jnp.eye(size))
        increment = 2 * increment + increment @ increment
    return increment + jnp.eye(size), integral @ B
