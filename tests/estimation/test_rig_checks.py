"""A prior that is no belief and noise that is no noise are refused by the rig."""

import jax.numpy as jnp
import pytest

import kedge
from kedge.core.errors import ContractError
from kedge.vehicles.unicycle import Unicycle

START = Unicycle().start()


def rig(cov=None, mean=START, vehicle=None, **parameters):
    cov = jnp.eye(3) if cov is None else cov
    sensor = kedge.Installation("gnss", kedge.make_sensor("gnss", **parameters))
    return kedge.Rig(vehicle or Unicycle(), (sensor,), kedge.Gaussian(mean, cov))


WRONG = {
    "negative": (jnp.diag(jnp.array([1.0, -1.0, 1.0])), "the eigenvalue -1"),
    "indefinite": (jnp.eye(3).at[0, 1].set(2.0).at[1, 0].set(2.0), "the eigenvalue -1"),
    "not symmetric": (jnp.eye(3).at[0, 1].set(0.1), "not symmetric"),
    "NaN": (jnp.eye(3) * jnp.nan, "not finite"),
    "too small": (jnp.eye(2), r"has shape \(2, 2\)"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_priors_that_are_no_belief(kind):
    cov, message = WRONG[kind]
    with pytest.raises(ContractError, match=f"the prior's covariance .*{message}"):
        rig(cov)


def test_means_that_are_no_state():
    with pytest.raises(ContractError, match="the prior's heading is nan"):
        rig(mean=START._replace(heading=jnp.array(jnp.nan)))
    with pytest.raises(ContractError, match=r"position has shape \(3,\), expected \(2,\)"):
        rig(mean=START._replace(position=jnp.zeros(3)))
    turning = kedge.make_vehicle("body-twist")
    for length in (0.0, 2.0):
        mean = turning.start()._replace(attitude=jnp.array([length, 0.0, 0.0, 0.0]))
        with pytest.raises(ContractError, match=f"of length {length:g}; expected a unit quat"):
            kedge.Rig(turning, (), kedge.Gaussian(mean, jnp.eye(12)))
    mean = turning.start()._replace(attitude=jnp.array([0.999, 0.0, 0.0, 0.0]))
    assert kedge.Rig(turning, (), kedge.Gaussian(mean, jnp.zeros((12, 12)))).names == ()


@pytest.mark.parametrize("std", [0.0, -0.3, float("nan")])
def test_noise_that_is_none(std):
    with pytest.raises(ContractError, match=r"sensors.gnss: the noise of position .*above 0"):
        rig(std=std)
    with pytest.raises(ContractError, match="the noise density of speed"):
        rig(vehicle=Unicycle(speed_noise=std if std else -1.0))
