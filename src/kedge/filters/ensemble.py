"""Stochastic ensemble Kalman filter."""

from typing import Any

import equinox as eqx
import jax
import jax.random as jr
from jaxtyping import PRNGKeyArray

from kedge.core.beliefs import Ensemble, Gaussian
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
from kedge.numerics.linalg import cholesky, gain, square_root, symmetric
from kedge.numerics.noise import process_std


@filters.add("ensemble")
class EnsembleKalman(AbstractFilter[Ensemble]):
    """Perturbed-observation EnKF with ``count`` members.

    The gain comes from sample covariances and the exact R; the covariance reported is that of
    the ensemble reported.

    Source: G. Burgers, P. van Leeuwen, G. Evensen, "Analysis scheme in the ensemble Kalman
    filter", Mon. Weather Rev. 126, 1998.
    """

    count: int = eqx.field(static=True, default=100)

    def __check_init__(self):
        if self.count < 2:
            raise ContractError(f"ensemble: count is {self.count}, must be at least 2")

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Ensemble:
        """Draw the members from the prior."""
        states = space(prior.mean)
        white = jr.normal(key, (self.count, states.size))
        errors = white @ square_root(prior.cov).T
        return Ensemble(jax.vmap(states.boxplus, (None, 0))(prior.mean, errors))

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Ensemble,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Ensemble:
        """Step every member with its own noise."""
        noises = space(vehicle.noise_density())
        draws = jr.normal(key, (self.count, noises.size)) * process_std(vehicle, dt)[None]

        def step(state, noise):
            return vehicle.step(state, control, noises.unflatten(noise), dt)

        return Ensemble(jax.vmap(step)(belief.members, draws))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Ensemble,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Ensemble, Innovation]:
        """Move every member towards its own perturbed copy of the measurement."""
        states, outputs = space(belief.members), space(measurement)
        mean = belief.moments().mean
        expected = jax.vmap(model.expect)(belief.members)
        residuals = jax.vmap(lambda z: outputs.boxminus(measurement, z))(expected)
        residual = residuals.mean(axis=0)

        errors = jax.vmap(states.boxminus, (0, None))(belief.members, mean)
        spread = residual[None] - residuals
        noise_cov = model.noise_cov(mean)
        S = symmetric(spread.T @ spread / (self.count - 1) + noise_cov)
        root = cholesky(S)
        K = gain(errors.T @ spread / (self.count - 1), root)

        noise = jr.normal(key, residuals.shape) @ square_root(noise_cov).T
        moved = jax.vmap(states.boxplus)(belief.members, (residuals + noise) @ K.T)
        return Ensemble(moved), innovation(residual, S, root, model.dof())
