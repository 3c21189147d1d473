"""Particle filter whose proposal looks at the reading."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import LastStep, Particles
from kedge.core.contracts import AbstractMeasurementModel
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.registry import filters, unknown
from kedge.filters.particle.cloud import AbstractParticleFilter, Sight, Weighed, look
from kedge.filters.particle.redraw import redrawable
from kedge.numerics.linalg import cholesky, solve_lower, solve_lower_transposed, symmetric
from kedge.numerics.linearity import require_differentiable
from kedge.numerics.propagation import AbstractPropagation, SigmaPoints, Taylor
from kedge.numerics.quadrature import unscented
from kedge.numerics.random import normals

PROPOSALS: dict[str, AbstractPropagation] = {
    "extended": Taylor(),
    "unscented": SigmaPoints(unscented),
}


@filters.add("guided")
class GuidedParticle(AbstractParticleFilter):
    r"""Each particle's last step is drawn anew from noise that fits the reading.

    The noise $w \sim N(0, I)$ of particle i's step, in standard deviations, is proposed, not
    the state: noise of lower rank than the state and states on manifolds need nothing more,
    and the state follows by the vehicle's own step. With
    $z - h(f(x_i, w)) \approx r - A w + v$, $v \sim N(0, R)$, the proposal is
    $q(w) = N(\mu, \Lambda^{-1})$, $\Lambda = I + A^\top R^{-1} A$,
    $\mu = \Lambda^{-1} A^\top R^{-1} r$, and the weight is exact whatever A is:
    $w_i \propto w_i \, p(z \mid x_i') \, N(w; 0, I) / q(w)$.

    ``proposal`` says where r and A come from: "extended" differentiates at $w = 0$;
    "unscented" regresses on sigma points of the noise, adds what the line leaves over to R,
    and needs no derivative. With ``iterations`` above 1 that is done again about the proposal
    just found: where a sharp reading lies far from what was expected of a curved model, two
    or three make a proposal that fits.

    What is drawn anew is the step between the last two events: of several predictions before
    one reading, the earlier ones stand as they were drawn. A reading that follows another
    without a prediction between is weighed as the bootstrap filter does, and what is reported
    before a reading is the bootstrap filter's prediction.

    Raises:
        ContractError: an unknown proposal, or fewer than one iteration; when first traced, if
            the proposal is "extended" and the model cannot be differentiated.

    Source: A. Doucet, S. Godsill, C. Andrieu, "On sequential Monte Carlo sampling methods for
    Bayesian filtering", Stat. Comput. 10, 2000, section II-D; R. van der Merwe, A. Doucet, N.
    de Freitas, E. Wan, "The unscented particle filter", NIPS 2000.
    """

    proposal: str = eqx.field(static=True, default="extended")
    iterations: int = eqx.field(static=True, default=1)

    looks_back: ClassVar[bool] = True

    def __check_init__(self):
        if self.proposal not in PROPOSALS:
            problem = unknown("proposal", self.proposal, list(PROPOSALS))
            raise ContractError(f"guided: {problem}")
        if self.iterations < 1:
            raise ContractError(f"guided: iterations is {self.iterations}, must be at least 1")

    def weigh(
        self,
        model: AbstractMeasurementModel,
        belief: Particles,
        measurement: Any,
        sight: Sight,
        key: PRNGKeyArray,
    ) -> Weighed:
        """Draw the last step from the proposal and weigh by the ratio of densities."""
        as_drawn = belief.states, belief.log_weights + sight.log_likelihood
        if belief.last is None:
            return Weighed(*as_drawn)
        last: LastStep = belief.last
        pending, step, std = redrawable(last)
        outputs = space(measurement)

        def propose(before: Any, white: Float[Array, " w"]) -> tuple[Any, Float[Array, ""]]:
            def expected(noise: Float[Array, " w"]) -> Any:
                return model.expect(step(before, noise * std))

            if self.proposal == "extended":
                require_differentiable(
                    expected,
                    white,
                    "GuidedParticle with proposal 'extended'",
                    "proposal='unscented', which needs no derivative",
                )
            unit = jnp.eye(std.shape[0], dtype=std.dtype)
            mean, factor = jnp.zeros_like(std), unit
            for _ in range(self.iterations):
                mean, factor = fit(expected, before, mean, factor)
            noise = mean + solve_lower_transposed(factor, white)
            log_ratio = (white @ white - noise @ noise) / 2 - jnp.sum(jnp.log(jnp.diag(factor)))
            return step(before, noise * std), log_ratio

        def fit(
            expected: Callable[[Float[Array, " w"]], Any],
            before: Any,
            mean: Float[Array, " w"],
            factor: Float[Array, "w w"],
        ) -> tuple[Float[Array, " w"], Float[Array, "w w"]]:
            """Mean and root of the precision of the noise, linearised over those given."""

            def around(error: Float[Array, " w"]) -> Any:
                return expected(mean + solve_lower_transposed(factor, error))

            unit = jnp.eye(std.shape[0], dtype=std.dtype)
            moments = PROPOSALS[self.proposal].propagated(around, unit)
            noise_cov = model.noise_cov(step(before, mean * std))
            if self.proposal != "extended":
                noise_cov = noise_cov + _left_over(moments.cov, moments.cross.T)
            A = moments.cross.T @ factor.T
            residual = outputs.boxminus(measurement, moments.mean)
            root = cholesky(symmetric(noise_cov))
            B = solve_lower(root, A)
            scaled = solve_lower(root, residual + A @ mean)
            precise = cholesky(unit + B.T @ B)
            return solve_lower_transposed(precise, solve_lower(precise, B.T @ scaled)), precise

        def redraw() -> tuple[Any, Float[Array, " N"]]:
            white = normals(key, (self.count, *std.shape), std.dtype)
            states, log_ratio = jax.vmap(propose)(last.before, white)
            seen = look(model, states, measurement).log_likelihood
            return states, belief.log_weights + seen + log_ratio

        return Weighed(*lax.cond(pending, redraw, lambda: as_drawn))


def _left_over(cov: Float[Array, "m m"], slope: Float[Array, "m w"]) -> Float[Array, "m m"]:
    """What a linear regression on the noise leaves of the expected measurement's covariance.

    Its diagonal only, kept from falling below zero by rounding: any positive value gives a
    valid proposal.
    """
    return jnp.diag(jnp.maximum(jnp.diag(cov - slope @ slope.T), 0.0))
