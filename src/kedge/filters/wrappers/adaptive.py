"""Measurement noise learned from the innovations, by sensor."""

from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from kedge.core.contracts import AbstractMeasurementModel, Innovation
from kedge.core.registry import filters
from kedge.filters.wrappers.learned_noise import AbstractNoiseLearner, Adapted
from kedge.filters.wrappers.wrapper import Inflated
from kedge.numerics.linalg import cholesky, solve_lower


@filters.add("adaptive")
class Adaptive(AbstractNoiseLearner):
    r"""Multiplies each sensor's R by a factor s that its innovations ask for.

    An innovation $\nu$ with m components and the state's share $H P H^\top = S - s R$ of its
    covariance gives one sample of s, the solution of
    $E[\nu^\top R^{-1} \nu] = s\,m + \mathrm{tr}(R^{-1} H P H^\top)$; the samples are averaged
    with exponential forgetting over about ``window`` readings, and the average is kept
    between ``floor`` and ``ceiling``. A reading is weighed, and its NIS is reported, with the
    factor that the readings before it gave, so consistency tests keep their sense. Readings
    that are refused teach nothing.

    Source: R. Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17(5),
    1972 (covariance matching); A. Mohamed, K. Schwarz, "Adaptive Kalman filtering for
    INS/GPS", J. Geodesy 73, 1999.
    """

    title: ClassVar[str] = "adaptive"

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Adapted, Innovation]:
        """The inner filter's update with the noise as learned so far; then learn from it."""
        name = self.source_of(model, belief)
        factor = belief.factor[name]
        noisy = Inflated(model, factor)
        posterior, score = self.inner.update(noisy, belief.belief, measurement, key)

        noise_cov = model.noise_cov(belief.moments().mean)
        root = cholesky(noise_cov)
        white = solve_lower(root, score.residual)
        share = solve_lower(root, solve_lower(root, score.cov - factor * noise_cov).T)
        dof = jnp.maximum(score.dof, 1)
        sample = (white @ white - jnp.trace(share)) / dof
        mixed = factor + (sample - factor) / self.window
        learned = jnp.where(score.accepted, jnp.clip(mixed, self.floor, self.ceiling), factor)

        # The unit noise that stands for a missing component was multiplied too.
        missing = score.residual.shape[0] - score.dof
        likelihood = score.log_likelihood + 0.5 * missing * jnp.log(factor)
        return (
            Adapted(posterior, belief.factor | {name: learned}, {}),
            score._replace(log_likelihood=likelihood),
        )
