"""Whether a log fits its rig: on numbers made by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.rig import Installation, Rig
from kedge.evaluation.plausibility import astray, off_by
from kedge.sensors.gnss import Gnss
from kedge.vehicles.augmented import Drift, augment
from kedge.vehicles.unicycle import Unicycle


def test_a_rig_that_is_right_is_off_by_one_and_outliers_do_not_matter():
    random = np.random.default_rng(1)
    dof = random.integers(1, 4, 4000)
    nis = random.chisquare(dof)
    assert off_by(nis, dof) == pytest.approx(1, abs=0.05)
    nis[::10] = 1e6
    assert off_by(nis, dof) == pytest.approx(1, abs=0.15)
    assert off_by(140.0**2 * random.chisquare(dof), dof) == pytest.approx(140, rel=0.05)


def test_nothing_is_said_of_readings_that_were_not_judged():
    assert off_by(np.array([np.nan, 3.0]), np.array([2, 0])) is None


@pytest.mark.parametrize(
    ("drift", "seconds", "std"),
    [
        (Drift(), 100.0, 0.02),
        (Drift(random_walk=0.01), 100.0, np.hypot(0.02, 0.1)),
        (Drift(random_walk=0.02 * np.sqrt(2 / 5), time_constant=5.0), 100.0, 0.02),
    ],
    ids=["constant", "walk", "Gauss-Markov"],
)
def test_a_quantity_is_astray_beyond_three_of_its_deviations(drift, seconds, std):
    gnss = Gnss()
    vehicle = augment(Unicycle(), {"speed_scale": drift}, [gnss])
    mean = vehicle.start()
    cov = jnp.diag(jnp.array([1.0, 1.0, 0.1, 0.02]) ** 2)
    rig = Rig(vehicle, (Installation("gnss", gnss, 1.0),), Gaussian(mean, cov))

    def at(sigmas):
        return Gaussian(mean._replace(speed_scale=mean.speed_scale + sigmas * std), cov)

    assert astray(rig, at(2.9), seconds) == {}
    ends = astray(rig, at(-3.1), seconds)
    assert list(ends) == ["speed_scale"]
    assert ends["speed_scale"] == pytest.approx(-3.1, rel=1e-3)
