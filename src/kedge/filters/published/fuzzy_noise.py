"""Measurement noise adapted by fuzzy rules on how well the innovations match."""

from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractMeasurementModel, Innovation
from kedge.core.registry import filters
from kedge.filters.wrappers.learned_noise import AbstractNoiseLearner, Adapted
from kedge.filters.wrappers.wrapper import Inflated
from kedge.numerics.fuzzy import inferred

RULES = {-2.0: -1.0, -1.0: -0.25, 0.0: 0.0, 1.0: 0.25, 2.0: 1.0}
"""Innovations 4 times, 2 times too small in square, as expected, 2 times, 4 times too large
(as powers of 2): change of the factor, in powers of 2 over one window."""


@filters.add("fuzzy-noise")
class FuzzyNoise(AbstractNoiseLearner):
    r"""Raises or lowers each sensor's R by rules on the degree of mismatch.

    The degree of mismatch is $q = \overline{\nu^\top S^{-1} \nu / m}$, the innovation's actual
    variance by the one expected under the noise as adapted so far, averaged with exponential
    forgetting over ``window`` readings of the sensor. Five rules (much smaller, smaller, as
    expected, larger, much larger than 1) say by how much the factor of R changes; small
    mismatches change it little, so that chance does not. With the change of one window's length
    the loop of average and factor is critically damped where the innovation is mostly noise.

    What is reported (NIS, likelihood, verdict) is the innovation under the nominal noise, so
    that gates and consistency tests keep their sense. Readings that are refused teach nothing.

    Source: P. Escamilla-Ambrosio and N. Mort, "Hybrid Kalman filter-fuzzy logic adaptive
    multisensor data fusion architectures", CDC 2003, section III (degree of mismatch); J.
    Sasiadek and Q. Wang, "Sensor fusion based on fuzzy Kalman filtering for autonomous robot
    vehicle", ICRA 1999.
    """

    title: ClassVar[str] = "fuzzy-noise"

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Adapted:
        """Every sensor's noise as it says, and no mismatch."""
        fresh = super().init(prior, key)
        return fresh._replace(ratio=dict(fresh.factor))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Adapted, Innovation]:
        """The inner filter's update with the noise as adapted so far; then adapt it."""
        name = self.source_of(model, belief)
        factor, ratio = belief.factor[name], belief.ratio[name]
        _, score = self.inner.update(model, belief.belief, measurement, key)
        noisy = Inflated(model, factor)
        posterior, felt = self.inner.update(noisy, belief.belief, measurement, key)

        seen = felt.nis / jnp.maximum(felt.dof, 1)
        mixed = ratio + (seen - ratio) / self.window
        # Below the smallest centre all means the same, and the logarithm stays finite.
        change = inferred(jnp.log2(jnp.maximum(mixed, 2.0**-8)), RULES) / self.window
        corrected = jnp.clip(factor * 2.0**change, self.floor, self.ceiling)
        taught = jnp.asarray(score.accepted) & felt.accepted
        learned = Adapted(
            posterior,
            belief.factor | {name: jnp.where(taught, corrected, factor)},
            belief.ratio | {name: jnp.where(taught, mixed, ratio)},
        )
        return learned, score
