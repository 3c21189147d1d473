"""What a nonlinear function does to a Gaussian: one strategy type, shared by the filters.

A strategy takes ``function(error)`` or ``function(error, noise)``, defined on the tangent
space around a belief's mean, and returns its :class:`PropagatedMoments` or, for square-root
filters, the :class:`Factors` of it.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.numerics.linalg import definite, mirrored, square_root
from kedge.numerics.linearity import is_affine
from kedge.numerics.quadrature import Rule

Function = Callable[..., Any]


class PropagatedMoments(NamedTuple):
    """A Gaussian seen through a function."""

    mean: Any
    """Point on the manifold of the function's values."""
    cov: Float[Array, "m m"]
    cross: Float[Array, "n m"]
    """Covariance of the error before with the value after."""
    posterior: Callable[[Float[Array, "n m"], Float[Array, "m m"]], Float[Array, "n n"]]
    r"""Covariance of ``error - K (value + noise)`` for any gain K and noise of covariance R:
    what is wrong with K only adds to it (Joseph's form, for every strategy)."""
    semidefinite: Callable[
        [Float[Array, "k k"]], tuple[Float[Array, "k k"], Int[Array, ""] | int]
    ]
    """Makes a covariance computed from these moments symmetric and, if the strategy's weights
    can be negative, projects it to a positive semi-definite one; counts the clipped pivots."""
    repairs: Int[Array, ""] | int = 0
    """How many were clipped in ``cov``, which is positive semi-definite already."""


class Factors(NamedTuple):
    r"""A Gaussian seen through a function, as deviations side by side.

    $P = E E^\top$, $P_{xz} = E A^\top$ and $P_{zz} = A A^\top$ for E before and A after.
    """

    mean: Any
    """Point on the manifold of the function's values."""
    before: Float[Array, "n k"]
    after: Float[Array, "m k"]


class AbstractPropagation(eqx.Module):
    """How a Gaussian is pushed through a function."""

    @property
    def signed(self) -> bool:
        """Whether weights may be negative, so that covariances may have to be repaired."""
        return False

    @property
    def affine(self) -> bool:
        """Whether every function is taken for an affine one, which leaves no residuals."""
        return False

    @abc.abstractmethod
    def propagated(
        self,
        function: Function,
        cov: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> PropagatedMoments:
        """Moments of ``function`` at an error of ``cov`` and, if given, independent noise."""

    @abc.abstractmethod
    def factors(
        self,
        function: Function,
        root: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> Factors:
        """The same at an error of covariance ``root @ root.T``, without forming a product.

        Raises:
            ContractError: a weight is negative, so there are no such deviations.
        """


class Taylor(AbstractPropagation):
    """First order about the mean; Jacobians by automatic differentiation.

    With ``affine_only`` a function that is not affine in its arguments is refused.
    """

    affine_only: bool = eqx.field(static=True, default=False)

    @property
    def affine(self) -> bool:
        """It is its tangent."""
        return True

    def propagated(
        self,
        function: Function,
        cov: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> PropagatedMoments:
        """Linearise at the origin."""
        mean, slope, effect = self._linearise(function, cov, noise_std)
        cross = cov @ slope.T
        after = slope @ cross
        if noise_std is not None:
            spread = effect * noise_std[None]
            after = after + spread @ spread.T

        def posterior(
            gain: Float[Array, "n m"], noise: Float[Array, "m m"]
        ) -> Float[Array, "n n"]:
            # (1 - K H) P (1 - K H)^T + K R K^T, by products with K and H, which are thin. The
            # last one is zero but for what is wrong with the gain, and for rounding.
            reduced = cov - gain @ cross.T
            return reduced - (reduced @ slope.T - gain @ noise) @ gain.T

        return PropagatedMoments(mean, mirrored(after), cross, posterior, _symmetric)

    def factors(
        self,
        function: Function,
        root: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> Factors:
        """``[L, 0]`` before, ``[F L, G q]`` after."""
        mean, slope, effect = self._linearise(function, root, noise_std)
        if noise_std is None:
            return Factors(mean, root, slope @ root)
        none = jnp.zeros((root.shape[0], noise_std.shape[0]), root.dtype)
        after = jnp.concatenate([slope @ root, effect * noise_std[None]], axis=1)
        return Factors(mean, jnp.concatenate([root, none], axis=1), after)

    def _linearise(
        self,
        function: Function,
        like: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None,
    ) -> tuple[Any, Float[Array, "m n"], Float[Array, "m w"]]:
        """Value at the origin, and the derivatives by the error and by the noise."""
        size, noises = like.shape[0], 0 if noise_std is None else noise_std.shape[0]
        origin = jnp.zeros(size + noises, like.dtype)

        def whole(joint: Float[Array, " nw"]) -> Any:
            return function(*jnp.split(joint, [size]) if noise_std is not None else (joint,))

        mean = whole(origin)
        values = space(mean)

        def deviation(joint: Float[Array, " nw"]) -> Float[Array, " m"]:
            return values.boxminus(whole(joint), mean)

        if self.affine_only and not is_affine(deviation, origin):
            raise ContractError(
                f"the filter 'kalman' needs a linear model, but {type(mean).__module__}."
                f"{type(mean).__qualname__} depends nonlinearly on the state or the noise; "
                "use 'extended' or 'unscented'"
            )
        # A model may compute in another precision than the belief has.
        jacobian = jax.jacfwd(deviation)(origin).astype(like.dtype)
        slope, effect = jnp.split(jacobian, [size], axis=1)
        return mean, slope, effect


class SigmaPoints(AbstractPropagation):
    """Weighted images of a quadrature rule's points; no Jacobian is formed.

    The mean on a manifold is taken about the image of the centre point, so a strongly
    negative centre weight cannot throw an angle across its seam.
    """

    rule: Callable[[int], Rule] = eqx.field(static=True)
    negative: bool = eqx.field(static=True, default=False)
    """Whether the rule has a negative covariance weight in some number of variables."""

    @property
    def signed(self) -> bool:
        """As the rule."""
        return self.negative

    def propagated(
        self,
        function: Function,
        cov: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> PropagatedMoments:
        """Push the points of the joint error and noise through the function."""
        rule, mean, errors, spread = self._push(function, square_root(cov), noise_std)
        weights = jnp.asarray(rule.cov_weights, cov.dtype)[:, None]
        semidefinite = _definite if rule.cov_weights.min() < 0 else _symmetric

        def posterior(
            gain: Float[Array, "n m"], noise: Float[Array, "m m"]
        ) -> Float[Array, "n n"]:
            # The points stand for cov exactly only under weights without beta's correction
            # of the centre; at the centre the error is zero, so the sum is right with it.
            residuals = errors - spread @ gain.T
            return residuals.T @ (weights * residuals) + gain @ noise @ gain.T

        after, repairs = semidefinite(spread.T @ (weights * spread))
        return PropagatedMoments(
            mean, after, errors.T @ (weights * spread), posterior, semidefinite, repairs
        )

    def factors(
        self,
        function: Function,
        root: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> Factors:
        """Deviations of the points from their mean, times the roots of their weights."""
        rule, mean, errors, spread = self._push(function, root, noise_std)
        if rule.cov_weights.min() < 0:
            raise ContractError(
                f"a weight of {rule.cov_weights.min():g} has no root: square-root forms need "
                "rules without negative weights, such as 'cubature'"
            )
        # A point without weight adds nothing.
        used = rule.cov_weights > 0
        weights = jnp.sqrt(jnp.asarray(rule.cov_weights[used], root.dtype))[None]
        return Factors(mean, errors[used].T * weights, spread[used].T * weights)

    def _push(
        self,
        function: Function,
        root: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None,
    ) -> tuple[Rule, Any, Float[Array, "k n"], Float[Array, "k m"]]:
        """The rule, the mean, and each point's deviation before and after."""
        size, noises = root.shape[0], 0 if noise_std is None else noise_std.shape[0]
        rule = self.rule(size + noises)
        points = jnp.asarray(rule.points, root.dtype)
        errors = points[:, :size] @ root.T
        arguments: tuple[Array, ...] = (errors,)
        if noise_std is not None:
            arguments += (points[:, size:] * noise_std[None],)
        mean, spread = weighted_images(rule, function, *arguments)
        return rule, mean, errors, spread


def weighted_images(
    rule: Rule, function: Function, *arguments: Float[Array, "k _"]
) -> tuple[Any, Float[Array, "k m"]]:
    """The mean of a rule's points seen through a function, and each one's deviation from it."""
    images = jax.vmap(function)(*arguments)
    values, dtype = space(images), arguments[0].dtype
    centre = jax.tree.map(lambda leaf: leaf[0], images)
    # A model may compute in another precision than the belief has.
    offsets = jax.vmap(values.boxminus, (0, None))(images, centre).astype(dtype)
    shift = jnp.asarray(rule.mean_weights, dtype) @ offsets
    return values.boxplus(centre, shift), offsets - shift[None]


def _definite(
    cov: Float[Array, "k k"],
) -> tuple[Float[Array, "k k"], Int[Array, ""]]:
    """Symmetric and semi-definite, and how many pivots had to be lifted for that."""
    return definite(mirrored(cov))


def _symmetric(cov: Float[Array, "k k"]) -> tuple[Float[Array, "k k"], int]:
    return mirrored(cov), 0
