"""By how much a radio's ranges are too long, as a function of what power it received."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.errors import DataError

LEAST = 12
"""Ranges that a knot of a curve needs."""


class PowerBias(NamedTuple):
    """A curve through knots, straight between them and constant beyond.

    The feature may be the received power, or that less the first path's, in dB or dBm: whatever
    ranges came with when the curve was fitted. What a range is too long by, and how much it
    scatters about that, goes to a solver as the bias and the noise of its link.

    Source: M. Shalaby, C. Cossette, J. Forbes, J. Le Ny, "Calibration and uncertainty
    characterization for ultra-wideband two-way-ranging measurements", IEEE International
    Conference on Robotics and Automation, 2023, arXiv 2210.05888 (bias and noise as functions
    of the received power; the robust knots are kedge's).
    """

    power: Float[np.ndarray, " k"]
    """Of the knots, rising; dB or dBm."""
    bias: Float[np.ndarray, " k"]  # m
    std: Float[np.ndarray, " k"]  # m

    def at(self, power: Any) -> tuple[Array, Array]:
        """Bias and noise of ranges that came with such power, m; of the whole if it is NaN."""
        x = jnp.asarray(power, float)
        knots = jnp.asarray(self.power)

        def read(values: Any) -> Array:
            levels = jnp.asarray(values)
            return jnp.where(jnp.isnan(x), jnp.median(levels), jnp.interp(x, knots, levels))

        return read(self.bias), read(self.std)


def fit_power_bias(power: Any, error: Any, knots: int = 6) -> PowerBias:
    """The curve of ranges with known errors (measured less true, m).

    As many ranges to each knot, which lies at the mean of their power; its bias is the median
    of their errors and its noise 1.4826 times the median distance from it, so that a few ranges
    far off change nothing.

    Raises:
        DataError: too few ranges for so many knots, or all of one power.
    """
    x, e = np.asarray(power, float).ravel(), np.asarray(error, float).ravel()
    if x.shape != e.shape:
        raise DataError(f"power bias: found {x.size} powers and {e.size} errors")
    valid = np.isfinite(x) & np.isfinite(e)
    x, e = x[valid], e[valid]
    if knots < 2 or len(x) < LEAST * knots:
        raise DataError(
            f"power bias: found {len(x)} ranges for {knots} knots, expected 2 knots or more "
            f"and {LEAST} ranges for each"
        )
    parts = np.array_split(np.argsort(x, kind="stable"), knots)
    places = np.array([x[part].mean() for part in parts])
    if np.any(np.diff(places) <= 0):
        raise DataError(
            f"power bias: the powers ({x.min():g} to {x.max():g}) are too alike for {knots} "
            "knots; ask for fewer"
        )
    middle = np.array([np.median(e[part]) for part in parts])
    pairs = zip(parts, middle, strict=True)
    spread = np.array([1.4826 * np.median(np.abs(e[part] - m)) for part, m in pairs])
    return PowerBias(places, middle, np.maximum(spread, 1e-6))
