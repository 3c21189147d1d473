"""Errors with a memory: what every filter and smoother says of itself against dense algebra."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.manifolds import considered_of, space
from kedge.core.registry import filters
from kedge.estimation.batch import estimate
from kedge.estimation.correlated_error import CorrelatedError
from kedge.estimation.error_states import with_error, with_errors
from kedge.estimation.rig import Installation, Rig
from kedge.estimation.smoother import smooth
from kedge.sensors.gnss import Gnss
from kedge.sensors.ranges import Ranges
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.vehicles.constant_velocity import ConstantVelocity

CONSIDERED = CorrelatedError(0.7, 2.0, treatment="considered")
ESTIMATED = CorrelatedError(jnp.array([0.7, 0.4]), jnp.array([2.0, 5.0]))


def rig_with(error, sensor=None, rate=2.0, **options):
    vehicle = ConstantVelocity(acceleration_noise=0.5)
    sensor = Gnss(std=0.5) if sensor is None else sensor
    installed = Installation("gnss", sensor, rate=rate, error=error, **options)
    return with_errors(Rig(vehicle, (installed,), Gaussian(vehicle.start(), jnp.eye(4))))


def log_of(rig, seconds=6.0):
    recording, truth = record(Scenario(rig, seconds, 0.5), jax.random.key(3), output_rate=2.0)
    return recording.log, truth


def dense(rig, log):
    """Covariance of all states at the readings and of all readings, from the models alone."""
    times = np.asarray(log.schedule.time)
    at = np.flatnonzero(np.asarray(log.schedule.sensor) >= 0)
    states, noises = space(rig.prior.mean), space(rig.vehicle.noise_density())
    size, density = states.size, noises.flatten(rig.vehicle.noise_density())
    control, origin = rig.vehicle.nominal_control(0.0), rig.vehicle.start()

    def step(error, noise, dt):
        state = states.boxplus(origin, error)
        moved = rig.vehicle.step(state, control, noises.unflatten(noise), dt)
        return states.boxminus(moved, origin)

    calm, still = jnp.zeros(noises.size), jnp.zeros(size)
    F, blocks, cov = np.eye(size), [], np.asarray(rig.prior.cov)
    whole = np.zeros((len(times) * size,) * 2)
    before, crosses = 0.0, np.zeros((0, size))
    for k, time in enumerate(times):
        dt = time - before
        before = time
        F, Q = np.eye(size), np.zeros((size, size))
        if dt > 0:
            F = np.asarray(jax.jacfwd(lambda e, d=dt: step(e, calm, d))(still))
            effect = np.asarray(jax.jacfwd(lambda w, d=dt: step(still, w, d))(calm))
            Q = effect @ np.diag(np.asarray(density) ** 2 / dt) @ effect.T
        cov = F @ cov @ F.T + Q
        crosses = np.concatenate([crosses @ F.T, cov])
        whole[: (k + 1) * size, k * size : (k + 1) * size] = crosses
        whole[k * size : (k + 1) * size, : (k + 1) * size] = crosses.T
        blocks.append(cov)
    (installed,) = rig.sensors
    zero = jnp.zeros((), int)
    H = np.asarray(
        jax.jacfwd(lambda e: jnp.ravel(installed.expect(states.boxplus(origin, e), zero)[0]))(
            still
        )
    )
    rows = np.zeros((len(at) * len(H), len(times) * size))
    for number, event in enumerate(at):
        rows[number * len(H) : (number + 1) * len(H), event * size : (event + 1) * size] = H
    R = np.kron(np.eye(len(at)), np.asarray(installed.noise_cov(origin, zero)))
    return whole, rows, R, size


def linear_map(filter, rig, log):
    """How the smoothed and the filtered means hang on the readings."""

    def means(positions):
        changed = log.readings[0]._replace(
            measurement=log.readings[0].measurement._replace(position=positions)
        )
        both = smooth(filter, rig, log._replace(readings=(changed,)))
        flatten = jax.vmap(space(rig.prior.mean).flatten)
        return [flatten(e.moments.mean) for e in both], [e.moments.cov for e in both]

    positions = log.readings[0].measurement.position
    slopes, covs = jax.jit(jax.jacfwd(means, has_aux=True))(positions)
    return [np.asarray(s).reshape(s.shape[0] * s.shape[1], -1) for s in slopes], covs


RULES = ["unscented", "square-root", "additive-unscented"]


@pytest.mark.parametrize("error", [CONSIDERED, ESTIMATED])
@pytest.mark.parametrize(
    "name", ["extended", *(pytest.param(rule, marks=pytest.mark.slow) for rule in RULES)]
)
def test_what_filter_and_smoother_say_of_their_errors_is_what_they_are(name, error):
    """For x - A z, with A the derivative of the estimates by the readings."""
    rig = rig_with(error)
    log, _ = log_of(rig)
    whole, rows, R, size = dense(rig, log)
    slopes, covs = linear_map(filters.make(name), rig, log)
    for slope, cov in zip(slopes, covs, strict=True):
        wrong = np.eye(len(whole)) - slope @ rows
        true = wrong @ whole @ wrong.T + slope @ R @ slope.T
        for event in range(len(cov)):
            cut = slice(event * size, (event + 1) * size)
            np.testing.assert_allclose(cov[event], true[cut, cut], rtol=1e-9, atol=1e-9)


def test_no_reading_corrects_what_is_considered():
    rig = rig_with(CONSIDERED)
    log, _ = log_of(rig)
    mean = estimate(filters.make("extended"), rig, log).moments.mean
    assert np.all(mean.error_of_gnss_position == 0)
    assert np.any(mean.position != 0)
    considered = np.asarray(considered_of(type(rig.prior.mean)))
    assert considered.tolist() == [False] * 4 + [True] * 2


def test_estimated_errors_smooth_as_the_dense_solution():
    """With the optimal gain the smoothed means are the regression on all readings."""
    rig = rig_with(ESTIMATED)
    log, _ = log_of(rig)
    whole, rows, R, _ = dense(rig, log)
    best = whole @ rows.T @ np.linalg.inv(rows @ whole @ rows.T + R)
    _, smoothed = linear_map(filters.make("extended"), rig, log)[0]
    np.testing.assert_allclose(smoothed, best, atol=1e-8)


def test_an_error_keeps_its_deviation_whatever_the_steps(key):
    rig = rig_with(ESTIMATED)
    belief, filter = rig.prior, filters.make("extended")
    for dt in (0.01, 0.7, 30.0):
        belief = filter.predict(
            rig.vehicle, belief, rig.vehicle.nominal_control(0.0), jnp.asarray(dt), key
        )
    np.testing.assert_allclose(np.diag(belief.cov)[4:], [0.49, 0.16], rtol=1e-12)


@pytest.mark.parametrize("name", ["ensemble", "particle", "iterated"])
def test_who_cannot_consider_says_so(name):
    rig = rig_with(CONSIDERED)
    log, _ = log_of(rig)
    with pytest.raises(ContractError, match="cannot consider errors"):
        estimate(filters.make(name), rig, log)


@pytest.mark.parametrize("by_target", [False, True])
def test_targets_have_errors_of_their_own_or_share_one(by_target):
    error = CorrelatedError(0.3, 5.0, by_target=by_target)
    rig = rig_with(error, Ranges(), all_targets=True)
    state = rig.prior.mean._replace(
        error_of_gnss_range=jnp.arange(1.0, 5.0) if by_target else jnp.array([2.0])
    )
    plain = dataclasses.replace(rig.sensors[0], error=None)
    for target in jnp.arange(4):
        more = rig.sensors[0].expect(state, target).range - plain.expect(state, target).range
        assert more == pytest.approx(target + 1.0 if by_target else 2.0)


def test_a_train_of_widened_readings_tells_of_a_constant_as_much_as_one_with_the_error():
    """200 readings of a place that stands: 1 / (H' (R + C)^-1 H) of the whole train."""
    std, tau, period = 0.7, 20.0, 0.5
    error = CorrelatedError(std, tau, treatment="widened")
    vehicle = ConstantVelocity(acceleration_noise=0.0)
    cov = jnp.diag(jnp.array([1e6, 1e6, 1e-12, 1e-12]))
    installed = Installation("gnss", Gnss(std=0.01), rate=1 / period, error=error)
    rig = with_errors(Rig(vehicle, (installed,), Gaussian(vehicle.start(), cov)))
    log, _ = log_of(rig, 100.0)
    last = estimate(filters.make("extended"), rig, log).moments.cov[-1, 0, 0]
    lag = np.abs(np.subtract.outer(np.arange(200), np.arange(200))) * period
    train = std**2 * np.exp(-lag / tau) + 1e-4 * np.eye(200)
    exact = 1 / np.linalg.inv(train).sum()
    # The formula is that of long trains: tau is a fifth of this one's length.
    assert last == pytest.approx(exact, rel=0.2)
    white = dataclasses.replace(rig, sensors=(dataclasses.replace(installed, error=None),))
    assert exact > 100 * estimate(filters.make("extended"), white, log).moments.cov[-1, 0, 0]


@pytest.mark.parametrize("treatment", ["estimated", "considered", "widened"])
def test_machine_code_computes_the_same(treatment):
    error = CorrelatedError(0.3, 5.0, by_target=True, treatment=treatment)
    rig = rig_with(error, Ranges(range_std=0.1), all_targets=True)
    log, _ = log_of(rig, 3.0)
    native, xla = (
        estimate(filters.make("extended"), rig, log, engine=engine)
        for engine in ("native", "xla")
    )
    for one, other in zip(
        jax.tree.leaves(native.moments), jax.tree.leaves(xla.moments), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_an_error_is_changed_in_all_places_at_once():
    changed = with_error(rig_with(CONSIDERED), "gnss", 0.2, 4.0)
    fresh = rig_with(dataclasses.replace(CONSIDERED, std=0.2, time_constant=4.0))
    for one, other in zip(jax.tree.leaves(changed), jax.tree.leaves(fresh), strict=True):
        np.testing.assert_allclose(one, other)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (CorrelatedError(jnp.ones(3), 1.0), "gnss.error.std: found 3 numbers, expected 1 or 2"),
        (CorrelatedError(0.0, 1.0), "expected 0 or more, one above 0"),
        (CorrelatedError(1.0, -1.0), "expected above 0 s"),
    ],
)
def test_an_error_that_does_not_fit_is_refused(error, message):
    with pytest.raises(ContractError, match=message):
        rig_with(error)
