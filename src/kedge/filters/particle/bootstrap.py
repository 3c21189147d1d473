"""Bootstrap particle filter."""

from typing import Any

from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Particles
from kedge.core.contracts import AbstractMeasurementModel
from kedge.core.registry import filters
from kedge.filters.particle.cloud import AbstractParticleFilter, Sight, Weighed


@filters.add("particle")
class BootstrapParticle(AbstractParticleFilter):
    r"""Particles proposed by the vehicle's own motion, $w_i \propto w_i \, p(z \mid x_i)$.

    It needs no derivative and no Gaussian. Where readings are much sharper than the motion,
    most particles miss them: 'guided' then does more with fewer.

    Source: N. Gordon, D. Salmond, A. Smith, "Novel approach to nonlinear/non-Gaussian
    Bayesian state estimation", IEE Proc. F 140(2), 1993.
    """

    def weigh(
        self,
        model: AbstractMeasurementModel,
        belief: Particles,
        measurement: Any,
        sight: Sight,
        key: PRNGKeyArray,
    ) -> Weighed:
        """Multiply each weight by the likelihood."""
        return Weighed(belief.states, belief.log_weights + sight.log_likelihood)
