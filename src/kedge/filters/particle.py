"""Bootstrap particle filter with systematic resampling."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax.scipy.special import logsumexp
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Gaussian, Particles
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky, square_root, symmetric
from kedge.numerics.noise import process_std
from kedge.numerics.resampling import effective_sample_size, systematic


@filters.add("particle")
class BootstrapParticle(AbstractFilter[Particles]):
    """``count`` particles, resampled when the effective size falls below ``threshold`` of it.

    A reading that no particle can explain leaves the belief as it was and is refused.

    Source: N. Gordon, D. Salmond, A. Smith, "Novel approach to nonlinear/non-Gaussian
    Bayesian state estimation", IEE Proc. F 140(2), 1993.
    """

    count: int = eqx.field(static=True, default=1000)
    threshold: Scalar = 0.5

    def __check_init__(self):
        if self.count < 2:
            raise ContractError(f"particle: count is {self.count}, must be at least 2")

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Particles:
        """Draw from the prior."""
        states = space(prior.mean)
        errors = jr.normal(key, (self.count, states.size)) @ square_root(prior.cov).T
        cloud = jax.vmap(states.boxplus, (None, 0))(prior.mean, errors)
        return Particles(cloud, jnp.full(self.count, -jnp.log(self.count)))

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Particles,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Particles:
        """Step every particle with its own noise."""
        noises = space(vehicle.noise_density())
        draws = jr.normal(key, (self.count, noises.size)) * process_std(vehicle, dt)[None]

        def step(state, noise):
            return vehicle.step(state, control, noises.unflatten(noise), dt)

        return belief._replace(states=jax.vmap(step)(belief.states, draws))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Particles,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Particles, Innovation]:
        """Weigh every particle by its likelihood; resample if few carry the weight."""
        outputs = space(measurement)

        def against(state):
            residual = outputs.boxminus(measurement, model.expect(state))
            noise_cov = model.noise_cov(state)
            score = innovation(residual, noise_cov, cholesky(noise_cov), model.dof())
            return residual, score.log_likelihood

        residuals, log_likelihoods = jax.vmap(against)(belief.states)
        log_weights = belief.log_weights + log_likelihoods
        evidence = logsumexp(log_weights)
        explained = jnp.isfinite(evidence)
        log_weights = jnp.where(explained, log_weights - evidence, belief.log_weights)

        prior = jnp.exp(belief.log_weights)
        residual = prior @ residuals
        spread = residuals - residual[None]
        noise_cov = model.noise_cov(belief.moments().mean)
        S = symmetric(spread.T @ (prior[:, None] * spread) + noise_cov)

        chosen = systematic(key, jnp.exp(log_weights))
        weighted = Particles(belief.states, log_weights)
        resampled = Particles(
            jax.tree.map(lambda leaf: leaf[chosen], belief.states),
            jnp.full(self.count, -jnp.log(self.count)),
        )
        depleted = effective_sample_size(log_weights) < self.threshold * self.count
        posterior = jax.tree.map(lambda a, b: jnp.where(depleted, a, b), resampled, weighted)
        score = innovation(residual, S, cholesky(S), model.dof())
        return posterior, score._replace(log_likelihood=evidence, accepted=explained)
