"""Updates that linearise again where the last linearisation led: the base of two filters."""

import abc
import functools as ft
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from equinox import AbstractVar
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.contracts import AbstractMeasurementModel, Innovation
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.filters.gaussian.recursion import (
    AbstractMomentPrediction,
    expectation_of,
    moved,
)
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky, gain, solve_lower, square_root, symmetric


class AbstractRelinearised(AbstractMomentPrediction):
    r"""Gauss-Newton on the manifold, in the prior's own units.

    With $P = L L^\top$ and the error $L u$ about the prior's mean, the prior of u is a standard
    normal, however singular P is. Each iteration replaces the measurement by
    $z \approx \bar z_i + A_i (u - u_i) + e$, $e \sim N(0, \Omega_i + R)$, and conditions the
    *prior* on it, so that the reading is counted once:
    $K = A^\top (A A^\top + \Omega + R)^{-1}$, $u_{i+1} = K (z \boxminus \bar z_i + A u_i)$,
    $C = (I - K A)(I - K A)^\top + K (\Omega + R) K^\top$ (Joseph's form).

    A step is halved, at most ``halvings`` times, until
    $\lvert u \rvert^2 + \lvert z \boxminus \bar z(u) \rvert^2_{(\Omega + R)^{-1}}$ does not
    grow, and is not taken if it still does. R is that of the prior's mean. What is reported
    is the innovation of the first iteration, which is the prior's.

    Source: B. Bell and F. Cathey, "The iterated Kalman filter update as a Gauss-Newton
    method", IEEE Trans. Autom. Control 38(2), 1993; M. Raitoharju, L. Svensson,
    Á. García-Fernández, R. Piché, "Damped posterior linearization filter", IEEE Signal
    Process. Lett. 25(4), 2018.
    """

    iterations: AbstractVar[int]
    halvings: AbstractVar[int]

    @abc.abstractmethod
    def around(self, cov: Float[Array, "n n"]) -> Float[Array, "n n"]:
        """Regular root of the spread over which to linearise, given the posterior's so far."""

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Any,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Any, Innovation]:
        """Condition on one measurement, several times over."""
        del key
        strategy, expect = self.strategy(), expectation_of(model, belief.mean)
        outputs = space(measurement)
        prior = square_root(belief.cov)
        one = jnp.eye(prior.shape[0], dtype=prior.dtype)
        noise_cov = jnp.asarray(model.noise_cov(belief.mean), prior.dtype)
        noise_root = square_root(noise_cov)

        def seen(point: Float[Array, " n"], root: Float[Array, "n n"]) -> Any:
            return strategy.factors(lambda error: expect(prior @ (point + error)), root)

        def merit(
            point: Float[Array, " n"], root: Float[Array, "n n"], weight: Float[Array, "m m"]
        ) -> Float[Array, ""]:
            away = outputs.boxminus(measurement, seen(point, root).mean)
            white = solve_lower(weight, away)
            return point @ point + white @ white

        point, root, factor, score = jnp.zeros_like(one[0]), one, one, None
        for _ in range(self.iterations):
            factors = seen(point, root)
            A = gain(factors.after @ factors.before.T, root)
            R, spreads = noise_cov, [noise_root]
            if not strategy.affine:
                residuals = factors.after - A @ factors.before
                R = symmetric(residuals @ residuals.T + noise_cov)
                spreads = [residuals, noise_root]
            S = symmetric(A @ A.T) + R
            S_root = cholesky(S)
            K = gain(A.T, S_root)
            residual = outputs.boxminus(measurement, factors.mean).astype(S.dtype)
            if score is None:
                score = innovation(residual, S, S_root, model.dof())
            target = K @ (residual + A @ point)
            # A component without noise has no weight of its own: only here, it gets some.
            floor = jnp.finfo(S.dtype).eps ** 0.5 * jnp.diag(jnp.diag(S))
            weight = cholesky(R + floor)
            point = self._step(point, target, ft.partial(merit, root=root, weight=weight))
            # As a sum of squares: a variance that vanishes must not come out below 0.
            factor = jnp.concatenate([one - K @ A, *(K @ spread for spread in spreads)], axis=1)
            root = self.around(symmetric(factor @ factor.T))

        assert score is not None  # there is at least one iteration
        mean, turn = moved(belief.mean, prior @ point)
        factor = prior @ factor if turn is None else turn @ prior @ factor
        return belief._replace(mean=mean, cov=symmetric(factor @ factor.T)), score

    def _step(
        self,
        start: Float[Array, " n"],
        end: Float[Array, " n"],
        merit: Callable[..., Float[Array, ""]],
    ) -> Float[Array, " n"]:
        """As far from ``start`` towards ``end`` as does not make things worse."""
        if self.halvings == 0:
            return end
        lengths = 0.5 ** jnp.arange(self.halvings + 1, dtype=start.dtype)
        points = start[None] + lengths[:, None] * (end - start)[None]
        merits = jax.vmap(merit)(jnp.concatenate([start[None], points]))
        # Room for rounding, or noise would decide whether the last small step is taken.
        slack = jnp.finfo(start.dtype).eps ** 0.5
        length, best = jnp.zeros_like(lengths[0]), merits[0] + slack * (1 + merits[0])
        # From the shortest step to the full one: the longest that helps is left.
        for i in reversed(range(self.halvings + 1)):
            length = jnp.where(merits[1 + i] <= best, lengths[i], length)
        return start + length * (end - start)


def check_iterations(name: str, iterations: int, halvings: int) -> None:
    """Refuse counts that make no filter.

    Raises:
        ContractError: fewer than 1 iteration, or fewer than 0 halvings.
    """
    if iterations < 1:
        raise ContractError(f"{name}: iterations is {iterations}, must be at least 1")
    if halvings < 0:
        raise ContractError(f"{name}: halvings is {halvings}, must be at least 0")
