"""Obstacles: their excess path, and what the signal tells of them."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.calibration.obstacles import (
    attenuation,
    excess_path,
    fit_suspicion,
    link_states,
    separation,
)
from kedge.core.errors import DataError


def test_the_excess_path_has_its_limits_and_is_linear():
    assert excess_path(0.0, 20.0, 5.0) == (0.0, 0.0)
    assert excess_path(8.0, 20.0, 1.0) == (0.4, 0.0)
    # By hand: 8 dB at 20 dB/m are 0.4 m; the root of 6.25 is 2.5, so 0.6 m.
    assert excess_path(8.0, 20.0, 6.25) == pytest.approx((0.4, 0.6))
    assert excess_path(16.0, 20.0, 6.25)[1] == pytest.approx(1.2)
    with pytest.raises(DataError, match=r"a permittivity of 0\.5"):
        excess_path(8.0, 20.0, 0.5)


def test_attenuation_compares_the_direct_path_with_the_strongest():
    assert attenuation([1.0, 0.5], [10e-9, 20e-9]) == 0.0
    # By hand: (2^2 20^2) / (1^2 10^2) = 16, which are 12.04 dB.
    assert attenuation([1.0, 2.0], [10e-9, 20e-9]) == pytest.approx(10 * np.log10(16))
    with pytest.raises(DataError, match="above 0"):
        attenuation([1.0, 0.0], [1e-9, 2e-9])


def test_suspicion_learns_the_odds():
    rng = np.random.default_rng(9)
    feature = rng.uniform(0, 14, 20000)
    blocked = rng.random(20000) < 1 / (1 + np.exp(-(-4.0 + 0.6 * feature)))
    found = fit_suspicion(feature, blocked)
    np.testing.assert_allclose(found, [-4.0, 0.6], rtol=0.05)
    std = found.std(jnp.array([-100.0, 100.0]), 0.05, 0.5)
    np.testing.assert_allclose(std, [0.05, 0.5], rtol=1e-6)
    assert separation(feature, blocked) > 0.85
    assert separation(rng.permutation(feature), blocked) == pytest.approx(0.5, abs=0.02)
    assert separation([1.0, 1.0, 2.0, 2.0], [0, 1, 0, 1]) == 0.5
    with pytest.raises(DataError, match="both links that are blocked"):
        fit_suspicion([1.0, 2.0], [1, 1])


def test_states_of_links_have_hysteresis():
    error = np.zeros((60, 3))
    error[10:30, 0] = 6.0
    error[:, 1] = -9.0  # too short a range is no obstacle
    error[20, 2] = 9.0  # nor is one outlier
    error[25, 0] = np.nan
    found = np.asarray(link_states(jnp.asarray(error)))
    # 6 (1 - 0.8^k) passes 3 at k = 4, and is 5.91 in the end; 5.91 * 0.8^8 is below 1.
    expected = np.zeros(60, bool)
    expected[13:37] = True
    assert found[:, 0].tolist() == expected.tolist()
    assert not found[:, 1:].any()
