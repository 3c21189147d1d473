"""Plain matrices against filterpy, closed forms and least squares."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge import filters

F = np.array([[1.0, 0.5], [0.0, 0.9]])
Q = np.array([[0.1, 0.03], [0.03, 0.2]])
H = np.array([[1.0, 0.0], [0.4, 1.0], [0.0, 2.0]])
R = np.array([[0.5, 0.1, 0.0], [0.1, 0.3, 0.0], [0.0, 0.0, 0.7]])
B = np.array([[0.5], [1.0]])
MEAN, COV = np.array([1.0, -1.0]), np.array([[2.0, 0.3], [0.3, 1.0]])
STEPS = 12


@pytest.fixture(scope="module")
def rows():
    random = np.random.default_rng(4)
    return random.normal(size=(STEPS, 3)), random.normal(size=(STEPS, 1))


def textbook(z, u, F=F, Q=Q, H=H, R=R):
    """FilterPy's filter: means, covariances, log-likelihood, and the filter itself."""
    from filterpy.kalman import KalmanFilter

    each = [np.broadcast_to(leaf, (STEPS, *np.shape(leaf)[-2:])) for leaf in (F, Q, H, R)]
    filter = KalmanFilter(dim_x=2, dim_z=3, dim_u=1)
    filter.x, filter.P, filter.B = MEAN.copy(), COV.copy(), B
    means, covs, total = [], [], 0.0
    for k in range(STEPS):
        filter.predict(u[k], F=each[0][k], Q=each[1][k])
        filter.update(z[k], H=each[2][k], R=each[3][k])
        means.append(filter.x.copy())
        covs.append(filter.P.copy())
        total += filter.log_likelihood
    return np.array(means), np.array(covs), total, filter


def test_the_filter_and_the_smoother_are_those_of_filterpy(rows):
    z, u = rows
    model = kedge.linear_model(F, Q, H, R, B=B)
    filtered, smoothed = kedge.smooth(
        filters.Kalman(), model.rig(MEAN, COV), model.log(z, inputs=u)
    )
    means, covs, total, filter = textbook(z, u)
    np.testing.assert_allclose(filtered.moments.mean.x, means, rtol=1e-10)
    np.testing.assert_allclose(filtered.moments.cov, covs, rtol=1e-10)
    assert float(filtered.log_likelihood) == pytest.approx(total, rel=1e-10)

    # Its smoother does not know of inputs.
    filtered, smoothed = kedge.smooth(filters.Kalman(), model.rig(MEAN, COV), model.log(z))
    means, covs, _, _ = textbook(z, 0 * u)
    means, covs, _, _ = filter.rts_smoother(means, covs, [F] * STEPS, [Q] * STEPS)
    np.testing.assert_allclose(smoothed.moments.mean.x, means, rtol=1e-9)
    np.testing.assert_allclose(smoothed.moments.cov, covs, rtol=1e-9)


def test_matrices_that_change_from_step_to_step(rows):
    z, u = rows
    growth = 1 + 0.1 * np.arange(STEPS)[:, None, None]
    many = F * growth, Q * growth, H / growth, R * growth**2
    model = kedge.linear_model(*many, B=B)
    found = kedge.estimate(
        filters.Kalman(), model.rig(MEAN, COV), model.log(z, inputs=u), engine="xla"
    )
    means, covs, total, _ = textbook(z, u, *many)
    np.testing.assert_allclose(found.moments.mean.x, means, rtol=1e-10)
    np.testing.assert_allclose(found.moments.cov, covs, rtol=1e-10)
    assert float(found.log_likelihood) == pytest.approx(total, rel=1e-10)


def test_noise_through_a_matrix_of_its_own(rows):
    z, _ = rows
    G, q = np.array([[0.5], [1.0]]), np.array([[0.3]])
    one = kedge.linear_model(F, q, H, R, G=G)
    other = kedge.linear_model(F, G @ q @ G.T, H, R)
    a, b = (kedge.estimate(filters.Kalman(), m.rig(MEAN, COV), m.log(z)) for m in (one, other))
    np.testing.assert_allclose(a.moments.cov, b.moments.cov, rtol=1e-10)


def test_the_gradient_of_the_likelihood_is_that_of_differences(rows):
    z, _ = rows

    def likelihood(logs):
        q, r = jnp.exp(logs)
        model = kedge.linear_model(F, q * Q, H, r * R)
        return kedge.estimate(
            filters.Kalman(), model.rig(MEAN, COV), model.log(z)
        ).log_likelihood

    at, step = jnp.array([0.3, -0.2]), 1e-5
    slopes = [
        (likelihood(at + step * side) - likelihood(at - step * side)) / (2 * step)
        for side in jnp.eye(2)
    ]
    np.testing.assert_allclose(jax.grad(likelihood)(at), slopes, rtol=1e-6)


def test_a_diffuse_prior_leaves_weighted_least_squares(rows):
    z, _ = rows
    model = kedge.linear_model(np.eye(2), np.zeros((2, 2)), H, R)
    found = kedge.estimate(filters.Kalman(), model.rig(), model.log(z, first=0)).moments
    weight = np.linalg.inv(R)
    information = STEPS * H.T @ weight @ H
    expected = np.linalg.solve(information, H.T @ weight @ z.sum(axis=0))
    np.testing.assert_allclose(found.mean.x[-1], expected, rtol=1e-6)
    np.testing.assert_allclose(found.cov[-1], np.linalg.inv(information), rtol=1e-6)


def test_what_was_not_measured_is_left_out(rows):
    z, u = rows
    gaps = z.copy()
    gaps[3] = np.nan
    model = kedge.linear_model(F, Q, H, R, B=B)
    found = kedge.estimate(
        filters.Kalman(), model.rig(MEAN, COV), model.log(gaps, inputs=u)
    ).moments
    before = found.cov[2]
    np.testing.assert_allclose(found.cov[3], F @ before @ F.T + Q, rtol=1e-10)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: kedge.linear_model(F, Q, H.T, R), "H has the shape"),
        (lambda: kedge.linear_model(F, np.eye(3), H, R), "G has the shape"),
        (lambda: kedge.linear_model(F, Q, H, R).log(np.zeros((4, 2))), "one row of 3"),
        (lambda: kedge.linear_model([F] * 3, Q, H, R).log(np.zeros((4, 3))), "3 steps"),
        (lambda: kedge.linear_model(F, Q, H, R).rig(np.zeros(3)), "mean has the shape"),
        (lambda: kedge.linear_model(F, Q, H, R, period=0.0), "period is 0"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(kedge.KedgeError, match=message):
        call()
