"""Square-root forms and repairs, against exact arithmetic."""

import functools as ft

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.registry import filters
from kedge.filters.gaussian.square_root import SquareRootKalman
from kedge.filters.gaussian.unscented import UnscentedKalman
from kedge.sensors.gnss import Gnss, Measurement
from kedge.sensors.landmarks import Landmark, Landmarks
from kedge.sensors.landmarks import Measurement as Sight
from kedge.testing import quick_jit
from kedge.vehicles import constant_velocity, unicycle


def exact(cov, steps, dt, density, std):
    """Covariance after predictions and updates, in 60 digits by the textbook's subtraction."""
    mpmath.mp.dps = 60
    P, m = mpmath.matrix(cov.tolist()), mpmath.mpf
    F, G, H = mpmath.eye(4), mpmath.zeros(4, 2), mpmath.zeros(2, 4)
    for i in (0, 1):
        F[i, i + 2], G[i, i], G[i + 2, i], H[i, i] = m(dt), m(dt) ** 2 / 2, m(dt), m(1)
    Q, R = G * G.T * (m(density) ** 2 / m(dt)), mpmath.eye(2) * m(std) ** 2
    for _ in range(steps):
        P = F * P * F.T + Q
        P = P - P * H.T * (H * P * H.T + R) ** -1 * H * P
    return np.array(P.tolist(), float)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_roots_keep_what_single_precision_can_hold(dtype, key):
    """R of 1e-12 beside a prior of 1e4, 16 decades, for 40 steps."""
    cov, dt, density, std = np.diag([1e4, 1e4, 1e2, 1e2]), 0.5, 1e-3, 1e-6
    prior = Gaussian(
        constant_velocity.State(jnp.zeros(2, dtype), jnp.zeros(2, dtype)),
        jnp.asarray(cov, dtype),
    )

    @quick_jit
    def run(prior):
        filter = SquareRootKalman(filters.make("kalman"))

        def cycle(belief, _):
            vehicle = constant_velocity.ConstantVelocity(density)
            control = constant_velocity.Control()
            belief = filter.predict(vehicle, belief, control, jnp.asarray(dt, dtype), key)
            seen = Measurement(jnp.zeros(2, dtype))
            return filter.update(Gnss(std=std), belief, seen, key)[0], None

        return jax.lax.scan(cycle, filter.init(prior, key), length=40)[0].moments()

    found = run(prior).cov
    assert found.dtype == dtype
    answer = exact(cov, 40, dt, density, std)
    scale = np.sqrt(np.outer(np.diag(answer), np.diag(answer)))
    # The rounding of each step times the condition of the root, which is the root of the
    # covariance's. Nothing damps it: with positions all but exact, 1 / var v grows with time.
    bound = 40 * float(jnp.finfo(dtype).eps) * np.sqrt(np.linalg.cond(answer))
    np.testing.assert_allclose(found / scale, answer / scale, atol=bound)


def test_negative_weights_are_refused():
    with pytest.raises(ContractError, match=r"square-root: inner is .*negative weights"):
        SquareRootKalman(UnscentedKalman(alpha=1e-3, beta=2.0, kappa=0.0))
    assert SquareRootKalman(UnscentedKalman(kappa=0.0)).inner.kappa == 0


@pytest.mark.parametrize("name", ["particle", "iterated", "dead-reckoning"])
def test_filters_without_deviations_are_refused(name):
    with pytest.raises(ContractError, match=r"square-root: inner is .*must be one of kalman"):
        SquareRootKalman(filters.make(name))


@pytest.mark.parametrize(
    "inner",
    ["cubature", *(pytest.param(n, marks=pytest.mark.slow) for n in ("extended", "unscented"))],
)
def test_it_is_its_inner_filter(inner, key):
    start = unicycle.State(jnp.array([1.0, 2.0]), jnp.array(3.0))
    prior = Gaussian(start, jnp.diag(jnp.array([0.5, 0.3, 0.2])))
    sensor = Landmarks(target=Landmark(jnp.array([[4.0, 1.0]]))).for_target(0)

    @quick_jit
    def both(prior):
        found = []
        for filter in (filters.make(inner), SquareRootKalman(filters.make(inner))):
            before, cross = filter.transition(
                unicycle.Unicycle(), filter.init(prior, key), unicycle.Control(1.0, 0.5), 0.4
            )
            after, score = filter.update(sensor, before, Sight(jnp.array(3.0), 0.1), key)
            found.append((before.moments(), cross, after.moments(), score))
        return found

    plain, rooted = both(prior)
    for one, other in zip(*map(jax.tree.leaves, (plain, rooted)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13)


# Negative weights, a landmark where the vehicle is thought to be, and a wide heading: the
# centre's image lies far from the mean of the others, and counts against them.
NEGATIVE = UnscentedKalman(beta=-6.0, kappa=-0.5)
WIDE = Gaussian(
    unicycle.State(jnp.zeros(2), jnp.array(0.0)), jnp.diag(jnp.array([4.0, 4.0, 1.0]))
)


@ft.cache
def cycle(filter):
    @quick_jit
    def run(prior):
        key = jax.random.key(0)
        sensor = Landmarks(
            range_std=0.1, bearing_std=0.1, target=Landmark(jnp.array([[0.01, 0.0]]))
        ).for_target(0)
        belief, first = filter.update(
            sensor, filter.init(prior, key), Sight(jnp.array(0.5), jnp.array(2.0)), key
        )
        gnss, control = Gnss(std=50.0), unicycle.Control(9.0, 0.0)
        wide = filter.init(prior, key)
        for _ in range(2):
            wide = filter.predict(unicycle.Unicycle(), wide, control, 1.0, key)
        after, second = filter.update(gnss, wide, Measurement(jnp.zeros(2)), key)
        return belief, first, wide, after, second

    return run


def test_repairs_are_counted_and_leave_a_covariance():
    belief, first, wide, after, second = cycle(NEGATIVE)(WIDE)
    for one in (belief, wide, after):
        cov = np.asarray(one.moments().cov)
        assert np.isfinite(cov).all()
        assert np.linalg.eigvalsh(cov).min() > -1e-9 * np.abs(cov).max()
    assert first.repairs > 0
    # What predictions had to repair waits for the next innovation, and is told once.
    assert wide.repairs > 0
    assert second.repairs >= wide.repairs
    assert belief.repairs == after.repairs == 0


def test_what_is_not_finite_is_not_repaired():
    broken = WIDE._replace(cov=WIDE.cov.at[0, 0].set(jnp.nan))
    belief, first, wide, _, _ = cycle(NEGATIVE)(broken)
    assert np.isnan(belief.cov).any()
    assert np.isnan(wide.cov).any()
    assert first.repairs == wide.repairs == 0


@pytest.mark.slow
def test_positive_weights_need_no_repairs():
    _, first, wide, _, second = cycle(UnscentedKalman())(WIDE)
    assert isinstance(wide, Gaussian)
    assert first.repairs == second.repairs == 0
