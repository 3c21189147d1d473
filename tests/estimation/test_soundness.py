"""After every step a belief is finite, of no variance below 0, or it is kept and that said."""

import functools
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jaxtyping import Array, Float

import kedge
from kedge.config.filters import build_filter
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractMeasurementModel
from kedge.core.errors import ContractError, DataError
from kedge.core.manifolds import Euclidean
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Readings, Stamped, assemble
from kedge.estimation.rig import Installation
from kedge.estimation.step import FilterState, is_sound, predict_to, process_measurement
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.recursion import RepairedGaussian
from kedge.sensors.gnss import Gnss, Measurement
from kedge.vehicles.constant_velocity import ContinuousWhiteAcceleration, Control
from kedge.vehicles.unicycle import Control as Drive
from kedge.vehicles.unicycle import Unicycle

KEY = jr.key(0)
GNSS = Installation("gnss", Gnss(std=0.3))


def fix(place) -> Readings:
    return Readings(Measurement(jnp.asarray(place, float)), jnp.asarray(0), None)


def test_what_is_sound():
    mean = Unicycle().start()
    good = Gaussian(mean, jnp.eye(3))
    assert is_sound(good)
    assert is_sound(good._replace(cov=jnp.zeros((3, 3))))
    for wrong in (
        good._replace(cov=jnp.eye(3).at[1, 1].set(-1e-300)),
        good._replace(cov=jnp.eye(3) * jnp.inf),
        good._replace(mean=mean._replace(heading=jnp.nan)),
        RepairedGaussian(mean, -jnp.eye(3), jnp.asarray(0)),
        {"inner": (good, good._replace(cov=-jnp.eye(3)))},
    ):
        assert not is_sound(wrong)


@pytest.mark.parametrize("record", [False, True])
def test_a_prediction_that_is_no_belief_is_made_up_for(record):
    """One NaN control: the belief stays, the reading is refused, and then no time is lost."""
    vehicle, filter = Unicycle(), ExtendedKalman()
    state = FilterState(Gaussian(vehicle.start(), 0.1 * jnp.eye(3)))
    good, bad = Drive(jnp.array(1.0), jnp.array(0.0)), Drive(jnp.array(jnp.nan), jnp.array(0.0))

    def to(state, control, time):
        return predict_to(filter, vehicle, state, control, jnp.asarray(time), KEY, record)

    stuck, history = to(state, bad, 1.0)
    assert jax.tree.all(jax.tree.map(jnp.array_equal, stuck.belief, state.belief))
    assert (history is not None) == record
    assert is_sound(history)
    assert (float(stuck.time), float(stuck.behind)) == (1.0, 1.0)
    after, outcome = process_measurement(filter, (GNSS,), 0, stuck, fix([1.0, 0.0]), KEY)
    assert Verdict(int(outcome.verdict)) is Verdict.UNPREDICTED
    assert jax.tree.all(jax.tree.map(jnp.array_equal, after.belief, state.belief))

    caught_up, _ = to(after, good, 1.5)
    whole, _ = to(state, good, 1.5)
    assert float(caught_up.behind) == 0.0
    for found, expected in zip(
        *map(jax.tree.leaves, (caught_up.belief, whole.belief)), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-13)
    _, outcome = process_measurement(filter, (GNSS,), 0, caught_up, fix([1.5, 0.0]), KEY)
    assert Verdict(int(outcome.verdict)) is Verdict.FUSED


@functools.cache
def tracker(name: str):
    """A filter's run over fixes of a point; one program for all noises and priors."""
    vehicle, filter = ContinuousWhiteAcceleration(0.5), build_filter(name)

    @jax.jit
    def run(prior, sensor, times, places):
        def next(state, row):
            time, place = row
            state, _ = predict_to(filter, vehicle, state, Control(), time, KEY)
            state, outcome = process_measurement(
                filter, (Installation("gnss", sensor),), 0, state, fix(place), KEY
            )
            moments = state.belief.moments()
            flat = jnp.concatenate([*moments.mean, moments.cov.ravel()])
            return state, (outcome.verdict, flat)

        state = FilterState(filter.init(prior, KEY))
        state = jax.tree.map(jnp.asarray, state._replace(time=0.0))
        return jax.lax.scan(next, state, (times, places))[1]

    return run


def track(name: str, std: float, prior: Gaussian):
    times = jnp.arange(1, 41) * 0.1
    places = jnp.stack([jnp.sin(times), 3e3 * times], axis=1)
    return tracker(name)(prior, Gnss(std=jnp.asarray(std)), times, places)


@pytest.mark.parametrize("spread", [1.0, 1e4])
def test_posterior_linearisation_with_exact_readings_is_the_kalman_filter(spread):
    start = ContinuousWhiteAcceleration().start()
    prior = Gaussian(start, jnp.diag(jnp.array([1.0, spread**2, 0.09, 4.0])))
    verdicts, found = track("posterior-linearisation", 0.0, prior)
    _, expected = track("kalman", 0.0, prior)
    assert set(np.asarray(verdicts).tolist()) == {int(Verdict.FUSED)}
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
    variances = np.asarray(found)[:, 4:].reshape(-1, 4, 4).diagonal(axis1=1, axis2=2)
    assert (variances >= 0).all()


class Six(NamedTuple):
    x: Annotated[Float[Array, "6"], Euclidean("m", (6,))]


class Three(NamedTuple):
    z: Annotated[Float[Array, "3"], Euclidean("m", (3,))]


class Exact(AbstractMeasurementModel):
    """Three sums of six components, without noise."""

    weights: Float[Array, "3 6"]

    def expect(self, state):
        return Three(self.weights @ state.x)

    def noise_cov(self, state):
        return jnp.zeros((3, 3))

    def dof(self):
        return 3


def test_exact_readings_of_badly_scaled_states_leave_numbers():
    """Two of these 200 were NaN while the posterior was a product that could be indefinite."""
    rng, filter = np.random.default_rng(0), build_filter("posterior-linearisation")
    F = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(3))
    Q = 1e-6 * np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.eye(3))
    model = Exact(jnp.asarray(rng.standard_normal((3, 6))))
    update = jax.jit(lambda belief, z: filter.update(model, belief, Three(z), KEY)[0])
    for _ in range(200):
        root = 10.0 ** rng.uniform(-3, 5, 6)[:, None] * rng.standard_normal((6, 6))
        belief = Gaussian(Six(jnp.zeros(6)), jnp.asarray(root @ root.T))
        for _ in range(3):
            belief = update(belief, jnp.asarray(rng.standard_normal(3)))
            assert is_sound(belief)
            cov = F @ np.asarray(belief.cov) @ F.T + Q
            mean = Six(jnp.asarray(F @ np.asarray(belief.mean.x)))
            belief = Gaussian(mean, jnp.asarray((cov + cov.T) / 2))


@pytest.mark.parametrize("name", ["unscented", "additive-unscented"])
def test_kappa_below_0_where_the_rule_exists(name):
    """Of any kappa, the points of a linear model have its moments: the Kalman filter's."""
    start = ContinuousWhiteAcceleration().start()
    prior = Gaussian(start, jnp.diag(jnp.array([1.0, 2.0, 0.09, 4.0])))
    _, expected = track("kalman", 0.3, prior)
    verdicts, found = track(f"{name}:kappa=-1", 0.3, prior)
    assert set(np.asarray(verdicts).tolist()) == {int(Verdict.FUSED)}
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    with pytest.raises(ContractError, match="must be > 0"):
        track(f"{name}:kappa=-4", 0.3, prior)


def test_single_precision_is_refused_where_it_would_lose_steps():
    stamps = (np.arange(200_000, 200_004, 0.01) * 1e9).astype(np.int64)
    fixes = Measurement(np.zeros((len(stamps), 2)))
    source = Stamped(stamps, Readings(fixes, np.zeros(len(stamps), int), None))
    controls = Drive(np.zeros(1), np.zeros(1))

    def log(start):
        return assemble(start, int(stamps[-1]), np.array([start]), controls, [source], 1e-5)

    assert len(log(0).stamps) > len(stamps)
    with jax.enable_x64(False):
        assert len(log(int(stamps[0]) - 10**9).stamps) > 0
        with pytest.raises(DataError, match=r"32-bit floats resolve 0.016 s.*JAX_ENABLE_X64=1"):
            log(0)


def test_exported():
    assert kedge.Verdict.UNPREDICTED == 9
