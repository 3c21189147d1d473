"""What a strategy makes of a function, against integrals that are known."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.core.quantities import Heading, Position
from kedge.numerics.propagation import SigmaPoints, Taylor
from kedge.numerics.quadrature import cubature, gauss_hermite, unscented
from kedge.testing import quick_jit


class Place(NamedTuple):
    position: Position


class Turn(NamedTuple):
    heading: Heading


def to_cartesian(error):
    """Range 1 m and bearing 90 degrees, perturbed."""
    distance, angle = 1 + error[0], jnp.pi / 2 + error[1]
    return Place(distance * jnp.stack([jnp.cos(angle), jnp.sin(angle)]))


POLAR = np.diag([0.02**2, np.deg2rad(15) ** 2])


def moments(strategy):
    """Mean, covariance and cross-covariance; the posterior is a function and stays inside."""
    return quick_jit(lambda cov: strategy.propagated(to_cartesian, cov)[:3])(POLAR)


def test_polar_to_cartesian():
    """Law 15: the sun of the textbooks. Exact mean of y is .966311, that of a line 1."""
    mean, cov, _ = moments(SigmaPoints(unscented))
    np.testing.assert_allclose(mean.position, [0, 0.966313728], atol=5e-10)
    # E[y] = E[r] exp(-s^2/2), and so on, in closed form.
    s = np.deg2rad(15) ** 2
    exact = np.exp(-s / 2)
    np.testing.assert_allclose(exact, 0.9663110876, atol=5e-11)
    # The rule is exact to third order, so what is left is of fourth: s^2 times a few.
    np.testing.assert_allclose(mean.position[1], exact, atol=s**2 / 8)
    np.testing.assert_allclose(cov[0, 0], 0.0640744417, rtol=2 * s)
    np.testing.assert_allclose(cov[1, 1], 0.0025684402, rtol=20 * s)


@pytest.mark.parametrize(("order", "digits"), [(3, 3), (5, 5), (9, 9)])
def test_gauss_hermite_tends_to_the_exact_moments(order, digits):
    """Law 15 to as many digits as the order has points, covariance included."""
    mean, cov, _ = moments(SigmaPoints(lambda n: gauss_hermite(n, order)))
    np.testing.assert_allclose(mean.position, [0, 0.9663110876], atol=10.0**-digits)
    exact = np.diag([0.0640744417, 0.0025684402])
    np.testing.assert_allclose(cov, exact, atol=10.0**-digits)


def test_cubature_is_exact_to_third_order():
    mean, _, _ = moments(SigmaPoints(cubature))
    s = np.deg2rad(15) ** 2
    np.testing.assert_allclose(mean.position, [0, np.exp(-s / 2)], atol=s**2 / 8)


def test_first_order_sees_no_shift():
    mean, cov, cross = moments(Taylor())
    np.testing.assert_allclose(mean.position, [0, 1], atol=1e-15)
    np.testing.assert_allclose(cov, np.diag([np.deg2rad(15) ** 2, 0.02**2]), atol=1e-15)
    np.testing.assert_allclose(cross, [[0, 0.02**2], [-(np.deg2rad(15) ** 2), 0]], atol=1e-15)


@pytest.mark.parametrize("strategy", [Taylor(), SigmaPoints(unscented)])
def test_moments_of_a_linear_function_are_exact(strategy):
    random = np.random.default_rng(0)
    slope, effect, factor, K = (random.normal(size=(2, n)) for n in (2, 3, 2, 2))
    cov, std, R = factor @ factor.T, np.array([0.3, 1.0, 0.0]), np.diag([0.5, 2.0])

    @quick_jit
    def images(cov, std):
        moved = strategy.propagated(lambda e, w: Place(slope @ e + effect @ w), cov, std)
        seen = strategy.propagated(lambda e: Place(slope @ e), cov)
        return moved[:3], seen[:3], seen.posterior(jnp.asarray(K), jnp.asarray(R))

    (mean, after, cross), seen, rest = images(cov, std)
    np.testing.assert_allclose(mean.position, 0, atol=1e-15)
    noise = effect @ np.diag(std**2) @ effect.T
    np.testing.assert_allclose(after, slope @ cov @ slope.T + noise, rtol=1e-12)
    np.testing.assert_allclose(cross, cov @ slope.T, rtol=1e-12)
    # Cov(e - K (y + v)), from the joint covariance of e and y alone.
    joint = np.block([[cov, seen[2]], [np.transpose(seen[2]), seen[1]]])
    apart = np.hstack([np.eye(2), -K])
    np.testing.assert_allclose(rest, apart @ joint @ apart.T + K @ R @ K.T, rtol=1e-11)


@pytest.mark.parametrize("heading", [0.0, 3.0, -np.pi])
def test_a_negative_centre_weight_does_not_jump_at_the_seam(heading):
    strategy = SigmaPoints(lambda n: unscented(n, alpha=1e-3, beta=2.0, kappa=0.0))

    @quick_jit
    def image(heading):
        def turned(error):
            return Turn(jnp.mod(heading + error[0] + jnp.pi, 2 * jnp.pi) - jnp.pi)

        return strategy.propagated(turned, jnp.array([[0.25]]))[:2]

    mean, cov = image(heading)
    gap = np.angle(np.exp(1j * (float(mean.heading) - heading)))
    np.testing.assert_allclose(gap, 0, atol=1e-9)
    np.testing.assert_allclose(cov, [[0.25]], rtol=1e-6)


def test_affine_only_refuses_a_curve():
    with pytest.raises(ContractError, match=r"Place depends nonlinearly.*use 'extended'"):
        Taylor(affine_only=True).propagated(to_cartesian, jnp.asarray(POLAR))
