"""Measurement noise that is learned: what is true comes out, sensor by sensor."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.verdicts import Verdict
from kedge.estimation.log import Readings
from kedge.estimation.online import Estimator
from kedge.estimation.reading import bind_reading
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.kalman import Kalman
from kedge.filters.wrappers.adaptive import Adaptive
from kedge.filters.wrappers.gated import Gated
from kedge.sensors.gnss import Gnss, Measurement
from kedge.sensors.velocity import MapVelocity
from kedge.sensors.velocity import Measurement as Speed
from kedge.testing import quick_jit
from kedge.vehicles.constant_velocity import ConstantVelocity, Control

VEHICLE = ConstantVelocity(acceleration_noise=0.3)
NAMES = ("gnss", "log")


def rig(gate=None):
    sensors = (
        Installation("gnss", Gnss(std=1.0), gate=gate),
        Installation("log", MapVelocity(std=0.2), gate=gate),
    )
    return Rig(VEHICLE, sensors, Gaussian(VEHICLE.start(), jnp.eye(4)))


def learned(window, gnss_std, log_std, steps=3000):
    """The factors over time, with readings of other noise than the sensors say."""
    filter = Adaptive(Kalman(), window=window).bind_sensors(NAMES)
    models = [named(s) for s in rig().sensors]
    start = VEHICLE.start()

    def body(carry, key):
        state, belief = carry
        shock, fix, speed = jax.random.normal(key, (3, 2))
        state = VEHICLE.step(state, Control(), type(VEHICLE.noise_density())(0.3 * shock), 1.0)
        belief = filter.predict(VEHICLE, belief, Control(), 1.0, key)
        seen = Measurement(state.position + gnss_std * fix)
        belief, first = filter.update(models[0], belief, seen, key)
        told = Speed(state.velocity + log_std * speed)
        belief, second = filter.update(models[1], belief, told, key)
        return (state, belief), (belief.factor, first.nis, second.nis)

    prior = Gaussian(start, jnp.eye(4))
    keys = jax.random.split(jax.random.key(5), steps)
    return jax.lax.scan(body, (start, filter.init(prior, keys[0])), keys)[1]


def named(installation):
    """The model of one reading of an installed sensor."""
    blank = {"gnss": Measurement(jnp.zeros(2)), "log": Speed(jnp.zeros(2))}[installation.name]
    return bind_reading(installation, Readings(blank, jnp.asarray(0)))[0]


def test_the_true_noise_is_learned_by_sensor():
    """GNSS three times as noisy as it says, the log as it says: factors 9 and 1."""
    factors, *nis = quick_jit(lambda: learned(300.0, 3.0, 0.2))()
    # 300 readings of 2 components know a variance to about 8 %; averaged over 2,500 steps less.
    np.testing.assert_allclose(np.mean(factors["gnss"][500:]), 9.0, rtol=0.08)
    np.testing.assert_allclose(np.mean(factors["log"][500:]), 1.0, rtol=0.08)
    # And with it the innovations are consistent: NIS has its 2 degrees of freedom on average.
    for found in nis:
        np.testing.assert_allclose(np.mean(found[500:]), 2.0, rtol=0.07)


def test_what_is_refused_teaches_nothing(key):
    estimator = Estimator(Adaptive(Kalman()), rig(gate=1e-6), key)
    estimator.push(1.0, "gnss", Measurement(np.array([1.0, 0.5])))
    before = dict(estimator.belief.factor)
    wild = estimator.push(2.0, "gnss", Measurement(np.array([1e3, 0.0])))
    assert wild.verdict == Verdict.GATED
    assert estimator.belief.factor["gnss"] == before["gnss"]
    # A gate inside teaches nothing either.
    inner = Estimator(Adaptive(Gated(Kalman(), 1e-6)), rig(), key)
    inner.push(2.0, "gnss", Measurement(np.array([1e3, 0.0])))
    assert inner.belief.factor["gnss"] == 1.0


def test_factors_stay_in_bounds(key):
    filter = Adaptive(Kalman(), window=1.0, floor=0.5, ceiling=4.0)
    estimator = Estimator(filter, rig(), key)
    estimator.push(0.1, "gnss", Measurement(np.array([50.0, 0.0])))
    assert estimator.belief.factor["gnss"] == 4.0
    estimator.push(0.2, "log", Speed(np.array(estimator.belief.moments().mean.velocity)))
    assert estimator.belief.factor["log"] == 0.5


def test_a_missing_component_counts_neither_way(key):
    """The likelihood of half a reading is that of the half that is there."""
    filter = Adaptive(Kalman(), window=2.0)
    one, other = Estimator(filter, rig(), key), Estimator(filter, rig(), key)
    for estimator in (one, other):
        estimator.push(1.0, "gnss", Measurement(np.array([9.0, 4.0])))
    half = one.push(2.0, "gnss", Measurement(np.array([3.0, np.nan])))
    before = other.push(2.0).moments
    variance = before.cov[0, 0] + other.belief.factor["gnss"]
    residual = 3.0 - before.mean.position[0]
    exact = -0.5 * (residual**2 / variance + np.log(2 * np.pi * variance))
    np.testing.assert_allclose(half.outcome.log_likelihood, exact, rtol=1e-10)
    # Of a half that is there, learning goes by one degree of freedom and not by two.
    known = other.belief.factor["gnss"]
    sample = residual**2 - before.cov[0, 0]
    np.testing.assert_allclose(
        one.belief.factor["gnss"], known + (sample - known) / 2, rtol=1e-10
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"window": 0.5}, "window is 0.5, must be at least 1"),
        ({"floor": 0.0}, "floor is 0 and ceiling 100; expected 0 < floor <= ceiling"),
        ({"floor": 3.0, "ceiling": 2.0}, "floor is 3 and ceiling 2"),
    ],
)
def test_bounds_that_cannot_be(given, message):
    with pytest.raises(ContractError, match=message):
        Adaptive(**given)


def test_a_sensor_that_it_was_not_told_of(key):
    filter = Adaptive(Kalman()).bind_sensors(("log",))
    model, belief = named(rig().sensors[0]), filter.init(rig().prior, key)
    with pytest.raises(ContractError, match=r"hears of the sensor 'gnss'.*told of \('log',\)"):
        filter.update(model, belief, Measurement(jnp.zeros(2)), key)
