"""Ranges that are in line of sight or not, nobody says which: expectation maximisation."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from kedge.positioning.fix import Fix, finished, inverse
from kedge.positioning.geometry import layout
from kedge.positioning.links import Links, directions, residuals, usable
from kedge.positioning.nonlinear import descend, nonlinear

ROUNDS = 20
INNER = 6
"""Steps of the position in each round."""


class Mixture(NamedTuple):
    """How ranges err where the line of sight is blocked, and how often it is."""

    mean: float | Array = 0.5  # m
    std: float | Array = 0.5  # m
    share: float | Array = 0.2


USUAL = Mixture()


def mixture(
    links: Links, blocked: Mixture = USUAL, near: Float[Array, " d"] | None = None
) -> Fix:
    r"""Maximise the likelihood of errors that are a mixture of two normal distributions.

    $D_i - \mu_i - d_i \sim (1 - \pi) N(0, \sigma_i) + \pi N(\mu_1, \sigma_1)$. In turn: the
    probability $\gamma_i$ that a range is in line of sight; then least squares with the weights
    $\gamma_i / \sigma_i^2 + (1 - \gamma_i) / \sigma_1^2$, each range less its expected excess.
    It starts from Huber's solution.

    Source: A. Dempster, N. Laird, D. Rubin, "Maximum likelihood from incomplete data via the EM
    algorithm", Journal of the Royal Statistical Society B 39(1), 1977, section 4.3.
    """
    safe, used = usable(links)
    mean, std, share = (jnp.asarray(value, safe.ranges.dtype) for value in blocked)

    def clear(position: Array) -> Array:
        """Probability that each range is in line of sight."""
        error = residuals(safe, position)
        direct = -0.5 * (error / safe.std) ** 2 - jnp.log(safe.std) + jnp.log1p(-share)
        other = -0.5 * ((error - mean) / std) ** 2 - jnp.log(std) + jnp.log(share)
        return 1 / (1 + jnp.exp(jnp.clip(other - direct, -700, 700)))

    def weighed(position: Array) -> tuple[Array, Array]:
        """Weight of each range, and the excess to take from it."""
        gamma = clear(position)
        direct, blocked = gamma / safe.std**2, (1 - gamma) / std**2
        return jnp.where(used, direct + blocked, 0.0), mean * blocked / (direct + blocked)

    def round_(_: Array, position: Array) -> Array:
        weights, excess = weighed(position)

        def total(point: Array) -> Array:
            return jnp.sum(weights * (residuals(safe, point) - excess) ** 2) / 2

        def normal(point: Array) -> tuple[Array, Array]:
            rows = directions(safe, point)
            lean = rows * weights[:, None]
            return lean.T @ rows, lean.T @ (residuals(safe, point) - excess)

        return descend(position, total, normal, INNER)

    start = nonlinear(links, "huber", near=near)
    position = lax.fori_loop(0, ROUNDS, round_, start.position)
    weights, _ = weighed(position)
    rows = directions(safe, position)
    cov = inverse((rows * weights[:, None]).T @ rows)
    return finished(links, layout(safe.anchors, used), position, cov)
