"""Unscented Kalman filter with additive noise: the form of most textbooks and libraries."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian, inflated_cov, stretch
from kedge.core.contracts import (
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.gaussian.recursion import corrected, expectation_of, motion, moved, turned
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky, gain, mirrored, square_root
from kedge.numerics.noise import process_std
from kedge.numerics.propagation import weighted_images
from kedge.numerics.quadrature import Rule, least_size, unscented


class SigmaPointBelief(NamedTuple):
    """A normal distribution, and the points that the next update looks at."""

    mean: Any
    cov: Float[Array, "n n"]
    errors: Float[Array, "k n"]
    """Of the points from the mean, in its tangent space."""
    noise_cov: Float[Array, "n n"]
    """What the points do not know of the covariance: noise that was added to it."""

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def inflated(self, factor: Scalar) -> "SigmaPointBelief":
        """The same mean, the covariance times ``factor`` but for augmented states."""
        grown = jnp.broadcast_to(stretch(self.mean, factor), self.errors.shape[1:])
        cov = inflated_cov(self.mean, self.cov, factor)
        noise_cov = self.noise_cov * grown[:, None] * grown[None]
        return self._replace(cov=cov, errors=self.errors * grown[None], noise_cov=noise_cov)


@filters.add("additive-unscented")
class AdditiveUnscentedKalman(AbstractGaussianFilter):
    r"""Sigma points of the state alone; the covariance of the noise is added.

    $P^- = \sum_i w_i (x_i \boxminus \bar x)(\cdot)^\top + G Q G^\top$ with
    $x_i = f(\chi_i, u, 0)$ and G the derivative by the noise at the mean; the update looks at
    new points of $P^-$ (Särkkä's form, section 5.6, and FilterPy's):
    $S = \sum_i w_i (z_i - \bar z)(\cdot)^\top + R$, $K = P_{xz} S^{-1}$ and
    $P^+ = P^- - K S K^\top$, as a sum of squares in which no digits cancel:
    $\sum_i w_i (x_i \boxminus \bar x - K (z_i - \bar z))(\cdot)^\top + K R K^\top$.

    Without ``redraw`` it looks at the points as they were propagated, as Wan and van der Merwe
    print it, and $G Q G^\top$ is added to $P^+$. Those points do not know the last step's
    noise, so on a linear model that is not the Kalman filter. The filter "unscented" differs
    from both in the third digit where a model is nonlinear: it draws new points too, and sends
    the noise through the model as further variables of its points. With ``alpha`` 1, ``beta``
    0 and ``kappa`` 0 it is the cubature filter with additive noise. After an update the points
    are drawn anew, for readings that come at one time.

    Source: S. Julier and J. Uhlmann, "Unscented filtering and nonlinear estimation", Proc.
    IEEE 92(3), 2004, section IV; E. Wan and R. van der Merwe, "The unscented Kalman filter
    for nonlinear estimation", AS-SPCC, 2000, table 3 (additive noise); S. Särkkä, "Bayesian
    Filtering and Smoothing", 2013, section 5.6.
    """

    alpha: float = eqx.field(static=True, default=1.0)
    beta: float = eqx.field(static=True, default=0.0)
    kappa: float = eqx.field(static=True, default=1.0)
    redraw: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        self._rule(least_size(self.kappa))

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> SigmaPointBelief:
        """The prior, with points of it."""
        del key
        return self._with_points(prior.mean, prior.cov)

    def considers(self) -> bool:
        """It does."""
        return True

    def transition(
        self, vehicle: AbstractVehicle, belief: SigmaPointBelief, control: Any, dt: Scalar
    ) -> tuple[SigmaPointBelief, Float[Array, "n n"]]:
        """Propagate the points without noise, and add its covariance."""
        step, std = motion(vehicle, belief.mean, control, dt), process_std(vehicle, dt)
        rule, states = self._rule(len(belief.cov)), space(belief.mean)
        errors = _points(rule, belief.cov)
        calm = jnp.zeros(std.shape)
        mean, spread = weighted_images(rule, lambda error: step(error, calm), errors)

        def by_noise(noise: Float[Array, " w"]) -> Float[Array, " n"]:
            return states.boxminus(step(states.zeros(), noise), mean)

        weights = jnp.asarray(rule.cov_weights)[:, None]
        effect = jax.jacfwd(by_noise)(calm) * std[None]
        noise_cov = effect @ effect.T
        cov = mirrored(spread.T @ (weights * spread) + noise_cov)
        after = SigmaPointBelief(mean, cov, spread, noise_cov)
        if self.redraw:
            after = self._with_points(mean, cov)
        return after, errors.T @ (weights * spread)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: SigmaPointBelief,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[SigmaPointBelief, Innovation]:
        """Condition on one measurement, seen from the points as they are."""
        del key
        rule = self._rule(len(belief.cov))
        expected, spread = weighted_images(
            rule, expectation_of(model, belief.mean), belief.errors
        )
        weights = jnp.asarray(rule.cov_weights)[:, None]
        noise_cov = model.noise_cov(belief.mean)
        cov = mirrored(spread.T @ (weights * spread) + noise_cov)
        root = cholesky(cov)
        K = corrected(belief.mean, gain(belief.errors.T @ (weights * spread), root))
        residual = space(expected).boxminus(measurement, expected)
        mean, turn = moved(belief.mean, K @ residual)
        errors = belief.errors - spread @ K.T
        posterior = errors.T @ (weights * errors) + K @ noise_cov @ K.T + belief.noise_cov
        after = turned(turn, mirrored(posterior))
        score = innovation(residual, cov, root, model.dof())
        return self._with_points(mean, after), score

    def _rule(self, size: int) -> Rule:
        return unscented(size, self.alpha, self.beta, self.kappa)

    def _with_points(self, mean: Any, cov: Float[Array, "n n"]) -> SigmaPointBelief:
        return SigmaPointBelief(
            mean, cov, _points(self._rule(len(cov)), cov), jnp.zeros_like(cov)
        )


def _points(rule: Rule, cov: Float[Array, "n n"]) -> Float[Array, "k n"]:
    return jnp.asarray(rule.points) @ square_root(cov).T
