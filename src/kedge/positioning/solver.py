"""The solvers by name, with their options in one place."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.errors import ContractError
from kedge.core.quantities import Metres, Ratio
from kedge.core.registry import unknown
from kedge.positioning import losses
from kedge.positioning.differences import differences
from kedge.positioning.fix import Fix
from kedge.positioning.linear import linear
from kedge.positioning.links import Links
from kedge.positioning.mixture import Mixture, mixture
from kedge.positioning.nonlinear import nonlinear

Near = Float[Array, " d"] | None

SOLVERS: dict[str, Callable[["Solver", Links, Any], Fix]] = {
    "ls": lambda own, links, near: linear(
        links, "none", False, own.reference - 1, near, own.printed
    ),
    "wls": lambda own, links, near: linear(links, "rows", own.debias, own.reference - 1, near),
    "wls-mean-square": lambda own, links, near: linear(
        links, "mean-square", own.debias, own.reference - 1, near
    ),
    "gls": lambda own, links, near: linear(links, "full", own.debias, 0, near),
    "ml": lambda own, links, near: nonlinear(
        links if own.debias else _undebiased(links), own.loss, own.tuning, near
    ),
    "nls": lambda own, links, near: nonlinear(_alike(links), own.loss, own.tuning, near),
    "em": lambda own, links, near: mixture(
        links if own.debias else _undebiased(links),
        Mixture(own.excess_mean, own.excess_std, own.excess_share),
        near,
    ),
    "tdoa": lambda own, links, near: differences(links, near),
}
"""Name -> what it does.

Least squares: "ls"; "wls" and "wls-mean-square" with the rows weighted as paper D has it; "gls"
with their full covariance. Maximum likelihood with a loss: "ml"; "nls" if nobody knows which
links are blocked; "em" for a mixture of line of sight and not. "tdoa" for differences."""


class Solver(eqx.Module):
    """One of :data:`SOLVERS` with its options; those of other solvers are ignored.

    Raises:
        ContractError: an unknown solver or loss, a number out of its range.
    """

    name: str = eqx.field(static=True, default="ml")
    debias: bool = eqx.field(static=True, default=True)
    """Take the mean excess that is expected of a link from its range."""
    reference: int = eqx.field(static=True, default=1)
    """Of "ls" and "wls": the anchor that is taken from the others, counted from 1."""
    printed: bool = eqx.field(static=True, default=False)
    """Of "ls": as paper D's equation 3 is printed."""
    loss: str = eqx.field(static=True, default="l2")
    tuning: Ratio = 0.0
    excess_mean: Metres = 0.5
    excess_std: Metres = 0.5
    excess_share: Ratio = 0.2

    def __check_init__(self):
        if self.name not in SOLVERS:
            raise ContractError(unknown("solver", self.name, list(SOLVERS)))
        tuning = self.tuning if isinstance(self.tuning, int | float) else 0.0
        losses.check_loss(self.loss, tuning)
        if self.reference < 1:
            raise ContractError(f"reference is {self.reference}, anchors are counted from 1")

    def solve(self, links: Links, near: Near = None) -> Fix:
        """One epoch; with ``jax.vmap`` many."""
        return SOLVERS[self.name](self, links, near)


@eqx.filter_jit
def solve_all(solver: Solver, epochs: Links, near: Near = None) -> Fix:
    """Every epoch by itself, all at once; the leaves of ``epochs`` have a leading axis."""
    return jax.vmap(lambda links: solver.solve(links, near))(epochs)


def _undebiased(links: Links) -> Links:
    return links._replace(bias=0.0 * links.bias)


def _alike(links: Links) -> Links:
    """Every link as good as the best, and without bias: nobody says which are blocked."""
    best = jnp.min(jnp.where(jnp.isnan(links.ranges), jnp.inf, links.std))
    return _undebiased(links._replace(std=jnp.full_like(links.std, best)))
