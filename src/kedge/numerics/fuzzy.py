"""Takagi-Sugeno rules over a box: its corners, and how much each counts at a point."""

import itertools
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


def corners(size: int) -> Bool[np.ndarray, "rules k"]:
    """The corners of a box in ``size`` variables: where each is at its upper end."""
    rows = list(itertools.product((False, True), repeat=size))
    return np.array(rows, bool).reshape(2**size, size)


def memberships(
    values: Float[Array, " k"], lower: Float[Array, " k"], upper: Float[Array, " k"]
) -> Float[Array, " rules"]:
    r"""How much each corner of the box counts at ``values``; the sum is 1.

    $\mu^+_j = (x_j - x^-_j) / (x^+_j - x^-_j)$, clipped to [0, 1], and
    $\mu^-_j = 1 - \mu^+_j$; a corner's weight is the product of its memberships. What is
    affine in each variable alone is interpolated exactly inside the box.

    Source: T. Takagi and M. Sugeno, "Fuzzy identification of systems and its applications to
    modeling and control", IEEE Trans. Syst. Man Cybern. 15(1), 1985; K. Tanaka and H. Wang,
    "Fuzzy Control Systems Design and Analysis", 2001, section 2.2 (sector nonlinearity).
    """
    rising = jnp.clip((values - lower) / (upper - lower), 0, 1)
    return jnp.prod(jnp.where(corners(values.shape[0]), rising[None], 1 - rising[None]), axis=1)


def inferred(value: Float[Array, ""], table: Mapping[float, float]) -> Float[Array, ""]:
    """What a table of rules concludes of ``value``: Sugeno's weighted average.

    Rule i says "if the value is near ``centre``, then ``conclusion``". Its membership is a
    triangle that is 1 at its own centre and 0 at those beside it, the outermost stay 1 beyond
    their centres, and so the average of the conclusions is their linear interpolation.

    Source: M. Sugeno, G. Kang, "Structure identification of fuzzy model", Fuzzy Sets and
    Systems 28, 1988 (constant conclusions).
    """
    centres = sorted(table)
    conclusions = [table[centre] for centre in centres]
    return jnp.interp(value, jnp.asarray(centres), jnp.asarray(conclusions))
