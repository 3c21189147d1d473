"""The most likely position, with a loss that forgives long ranges."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from kedge.positioning import losses
from kedge.positioning.fix import Fix, finished, inverse
from kedge.positioning.geometry import layout, nearer
from kedge.positioning.linear import linear
from kedge.positioning.links import Links, directions, residuals, usable

STEPS = 40
"""Of the iteration, always: epochs are solved side by side."""


def nonlinear(
    links: Links,
    loss: str = "l2",
    tuning: float | Array = 0.0,
    near: Float[Array, " d"] | None = None,
    start: Float[Array, " d"] | None = None,
) -> Fix:
    r"""Minimise $\sum_i \rho((D_i - \mu_i - \lVert x - a_i \rVert) / \sigma_i)$.

    With ``loss`` "l2" this is the most likely position for normal errors, and attains the
    Cramér-Rao bound. It starts from the linear solution; losses that turn back start from
    Huber's. ``tuning`` 0 is the usual scale, see :data:`kedge.positioning.losses.TUNING`.

    Each of the :data:`STEPS` steps is Marquardt's: Gauss-Newton with the curvature of the loss,
    damped by ten times more whenever the cost would rise, and then not taken.

    Source: P. Huber, E. Ronchetti, "Robust Statistics", 2nd ed., 2009, section 7.8; D.
    Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", Journal of
    the Society for Industrial and Applied Mathematics 11(2), 1963.
    """
    losses.check_loss(loss, tuning if isinstance(tuning, int | float) else 1.0)
    safe, used = usable(links)
    shape = layout(safe.anchors, used)
    if start is None:
        begun = linear(links, near=near).position
        centre = shape.centre + shape.axes[:, 0]
        begun = jnp.where(jnp.isnan(begun).any(), centre, begun)
    else:
        begun = start
    if loss in losses.REDESCENDING:
        begun = _descended(safe, used, "huber", losses.TUNING["huber"], begun)
    scale = jnp.where(jnp.asarray(tuning) > 0, tuning, losses.TUNING[loss])
    position = _descended(safe, used, loss, scale, begun)
    if start is None:
        nowhere = jnp.full_like(position, jnp.nan)
        position = nearer(shape, position, nowhere if near is None else near)
    weights = losses.weight(loss, scale, residuals(safe, position) / safe.std)
    rows = directions(safe, position) * (used / safe.std)[:, None]
    cov = inverse((rows * weights[:, None]).T @ rows)
    return finished(links, shape, position, cov)


def _descended(
    links: Links,
    used: Bool[Array, " m"],
    loss: str,
    scale: Array | float,
    start: Float[Array, " d"],
) -> Float[Array, " d"]:
    def errors(position: Array) -> Array:
        return jnp.where(used, residuals(links, position) / links.std, 0.0)

    def total(position: Array) -> Array:
        return jnp.sum(losses.cost(loss, scale, errors(position)))

    def normal(position: Array) -> tuple[Array, Array]:
        error = errors(position)
        rows = directions(links, position) * (used / links.std)[:, None]
        bent = rows * losses.curvature(loss, scale, error)[:, None]
        return bent.T @ rows, rows.T @ (losses.weight(loss, scale, error) * error)

    return descend(start, total, normal)


def descend(
    start: Float[Array, " n"],
    total: Callable[[Array], Array],
    normal: Callable[[Array], tuple[Array, Array]],
    steps: int = STEPS,
) -> Float[Array, " n"]:
    """Damped Gauss-Newton steps for normal equations ``(matrix, right side)``, never uphill."""

    def step(_: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        point, least, damping = carry
        matrix, right = normal(point)
        diagonal = jnp.diag(jnp.diag(matrix) + 1e-12 * jnp.trace(matrix))
        trial = point + inverse(matrix + damping * diagonal) @ right
        cost_there = total(trial)
        better = cost_there <= least
        return (
            jnp.where(better, trial, point),
            jnp.where(better, cost_there, least),
            jnp.clip(jnp.where(better, damping / 10, damping * 10), 1e-12, 1e12),
        )

    begin = start, total(start), jnp.asarray(1e-3, start.dtype)
    return lax.fori_loop(0, steps, step, begin)[0]
