"""Kalman filter on a linearised model, in the forms in which it is published."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian, inflated_cov
from kedge.core.contracts import (
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import Space, space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters, unknown
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.numerics.linalg import symmetric
from kedge.numerics.noise import process_std
from kedge.numerics.propagation import Taylor

CHOICES: dict[str, list[str]] = {
    "predictor": ["affine", "jx"],
    "covariance": ["correct", "literal"],
    "point": ["estimate", "start"],
}


class Anchored(NamedTuple):
    """A normal distribution, and the state that it started from."""

    mean: Any
    cov: Float[Array, "*batch n n"]
    anchor: Any

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def inflated(self, factor: Scalar) -> Any:
        """The same mean, the covariance times ``factor`` but for augmented states."""
        return self._replace(cov=inflated_cov(self.mean, self.cov, factor))


@filters.add("linearised")
class LinearisedKalman(AbstractGaussianFilter):
    r"""By the model's derivatives F (state), B (control) and G (noise), as papers print it.

    * ``predictor``: "affine" is $x^- = f(x_0, u) + F (\hat x - x_0)$ about the ``point``
      $x_0$, which at the estimate is $f(\hat x, u)$; "jx" is the published
      $x^- = F \hat x + B u$ without the offset. For what is of second degree in x, F x is
      twice as large (Euler's theorem), so forces are counted twice.
    * ``covariance``: "correct" is $F P F^\top + G Q G^\top$; "literal" the published
      $(F - I) P (F - I)^\top + G Q G^\top$, which forgets what was known.
    * ``point``: where the derivatives are taken: at the "estimate", anew in each step, or at
      the "start", once and for all.

    By default it is the extended filter.

    Raises:
        ContractError: an unknown option.

    Source: Ngatini et al., "Comparison of AUV position estimation using Kalman filter,
    ensemble Kalman filter and fuzzy Kalman filter algorithm in the specified trajectories",
    2022, equations 29 to 50.
    """

    predictor: str = eqx.field(static=True, default="affine")
    covariance: str = eqx.field(static=True, default="correct")
    point: str = eqx.field(static=True, default="estimate")

    def __check_init__(self):
        for field, known in CHOICES.items():
            if getattr(self, field) not in known:
                what = unknown(field, getattr(self, field), known)
                raise ContractError(f"linearised: {what}")

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """The prior, and its mean if derivatives are taken there."""
        del key
        return prior if self.point == "estimate" else Anchored(*prior, prior.mean)

    def considers(self) -> bool:
        """It does."""
        return True

    def transition(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar
    ) -> tuple[Any, Float[Array, "n n"]]:
        """By the linear model."""
        at = belief.mean if self.point == "estimate" else belief.anchor
        line = line_at(vehicle, at, at, control, dt)
        mean = line.predicted(belief.mean, self.predictor)
        cov = line.spread(belief.cov, self.covariance)
        return belief._replace(mean=mean, cov=cov), belief.cov @ line.slope.T

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """The extended filter's."""
        return ExtendedKalman().update(model, belief, measurement, key)


class Line(NamedTuple):
    """A vehicle's step, linearised."""

    at: Any
    """The state about which."""
    after: Any
    """The step of that state."""
    slope: Float[Array, "n n"]
    """F."""
    effect: Float[Array, "n w"]
    """G times the standard deviation of the noise."""
    drive: Float[Array, " n"]
    """B u."""

    def predicted(self, estimate: Any, predictor: str) -> Any:
        """The state after the step, by the line or by its published form."""
        states = space(estimate)
        if predictor == "jx":
            return states.boxplus(
                origin_of(states), self.slope @ coordinates(estimate) + self.drive
            )
        apart = states.boxminus(estimate, self.at)
        return states.boxplus(self.after, self.slope @ apart)

    def spread(self, cov: Float[Array, "n n"], form: str) -> Float[Array, "n n"]:
        """The covariance after the step, by a form of its equation."""
        F = self.slope
        if form == "literal":
            F = F - jnp.eye(F.shape[0], dtype=F.dtype)
        return symmetric(F @ cov @ F.T + self.effect @ self.effect.T)


def line_at(vehicle: AbstractVehicle, at: Any, steered: Any, control: Any, dt: Scalar) -> Line:
    """Linearise a step about the state ``at``, and by the control about ``steered``."""
    states, noises, controls = space(at), space(vehicle.noise_density()), space(control)
    std = process_std(vehicle, dt)
    calm = noises.unflatten(jnp.zeros_like(std))

    def step(error: Float[Array, " n"], noise: Float[Array, " w"]) -> Any:
        displaced = states.boxplus(at, error)
        return vehicle.step(displaced, control, noises.unflatten(noise), dt)

    unit = jnp.eye(states.size, dtype=std.dtype)
    factors = Taylor().factors(step, unit, std)
    slopes, size = factors.after, states.size
    held = vehicle.step(steered, control, calm, dt)

    def steer(shift: Float[Array, " u"]) -> Float[Array, " n"]:
        other = controls.boxplus(control, shift)
        return states.boxminus(vehicle.step(steered, other, calm, dt), held)

    given = coordinates(control)
    drive = jax.jvp(steer, (jnp.zeros_like(given),), (given,))[1]
    return Line(at, factors.mean, slopes[:, :size], slopes[:, size:], drive)


def coordinates(point: Any) -> Float[Array, " n"]:
    """A point as a tangent vector from the origin of its charts."""
    states = space(point)
    return states.boxminus(point, origin_of(states))


def origin_of(states: Space) -> Any:
    """The point from which coordinates are counted."""
    missing = states.cls(*(jnp.full(chart.shape, jnp.nan) for chart in states.charts))
    return states.complete(missing)[0]
