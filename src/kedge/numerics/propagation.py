"""What a nonlinear function does to a Gaussian: one strategy type, shared by the filters.

A strategy takes ``function(error)`` or ``function(error, noise)``, defined on the tangent
space around a belief's mean, and returns its :class:`Image`.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.numerics.linalg import square_root
from kedge.numerics.linearity import is_affine
from kedge.numerics.quadrature import Rule


class Image(NamedTuple):
    """A Gaussian seen through a function."""

    mean: Any
    """Point on the manifold of the function's values."""
    cov: Float[Array, "m m"]
    cross: Float[Array, "n m"]
    """Covariance of the error before with the value after."""
    remainder: Callable[[Float[Array, "n m"]], Float[Array, "n n"]]
    """Covariance of ``error - K value`` for any gain K: positive semi-definite as computed,
    so rounding cannot break the posterior (Joseph's form, for every strategy)."""


class AbstractPropagation(eqx.Module):
    """How a Gaussian is pushed through a function."""

    @abc.abstractmethod
    def image(
        self,
        function: Callable[..., Any],
        cov: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> Image:
        """Moments of ``function`` at an error of ``cov`` and, if given, independent noise."""


class Taylor(AbstractPropagation):
    """First order about the mean; Jacobians by automatic differentiation.

    With ``affine_only`` a function that is not affine in its arguments is refused.
    """

    affine_only: bool = eqx.field(static=True, default=False)

    def image(
        self,
        function: Callable[..., Any],
        cov: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> Image:
        """Linearise at the origin."""
        sizes = [cov.shape[0]] if noise_std is None else [cov.shape[0], noise_std.shape[0]]
        origin = jnp.zeros(sum(sizes))

        def whole(joint):
            return function(*jnp.split(joint, sizes[:1]) if len(sizes) > 1 else (joint,))

        mean = whole(origin)
        values = space(mean)

        def deviation(joint):
            return values.boxminus(whole(joint), mean)

        if self.affine_only and not is_affine(deviation, origin):
            raise ContractError(
                f"the filter 'kalman' needs a linear model, but {type(mean).__module__}."
                f"{type(mean).__qualname__} depends nonlinearly on the state or the noise; "
                "use 'extended' or 'unscented'"
            )
        jacobian = jax.jacfwd(deviation)(origin)
        slope = jacobian[:, : sizes[0]]
        image = slope @ cov @ slope.T
        if noise_std is not None:
            spread = jacobian[:, sizes[0] :] * noise_std[None]
            image = image + spread @ spread.T

        def remainder(gain):
            rest = jnp.eye(sizes[0]) - gain @ slope
            return rest @ cov @ rest.T

        return Image(mean, image, cov @ slope.T, remainder)


class SigmaPoints(AbstractPropagation):
    """Weighted images of a quadrature rule's points; no Jacobian is formed.

    The mean on a manifold is taken about the image of the centre point, so a strongly
    negative centre weight cannot throw an angle across its seam.
    """

    rule: Callable[[int], Rule] = eqx.field(static=True)

    def image(
        self,
        function: Callable[..., Any],
        cov: Float[Array, "n n"],
        noise_std: Float[Array, " w"] | None = None,
    ) -> Image:
        """Push the points of the joint error and noise through the function."""
        size, noises = cov.shape[0], 0 if noise_std is None else noise_std.shape[0]
        rule = self.rule(size + noises)
        errors = jnp.asarray(rule.points[:, :size]) @ square_root(cov).T
        arguments: tuple[Array, ...] = (errors,)
        if noise_std is not None:
            arguments += (jnp.asarray(rule.points[:, size:]) * noise_std[None],)
        images = jax.vmap(function)(*arguments)
        values = space(images)
        centre = jax.tree.map(lambda leaf: leaf[0], images)
        offsets = jax.vmap(values.boxminus, (0, None))(images, centre)
        shift = jnp.asarray(rule.mean_weights) @ offsets
        spread = offsets - shift[None]
        weights = jnp.asarray(rule.cov_weights)[:, None]

        def remainder(gain):
            # The points stand for cov exactly only under weights without beta's correction
            # of the centre; at the centre the error is zero, so the sum is right with it.
            rest = errors - spread @ gain.T
            return rest.T @ (weights * rest)

        return Image(
            mean=values.boxplus(centre, shift),
            cov=spread.T @ (weights * spread),
            cross=errors.T @ (weights * spread),
            remainder=remainder,
        )
