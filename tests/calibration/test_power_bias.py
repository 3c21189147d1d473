"""Ranges that are too long by what their received power says."""

import numpy as np
import pytest

from kedge.calibration.power_bias import fit_power_bias
from kedge.core.errors import DataError
from kedge.positioning.links import links
from kedge.positioning.solver import Solver, solve_all

ROOM = np.array([[0.0, 0.0], [0.0, 6.0], [5.0, 0.0], [5.0, 6.0]])


def true_bias(power):
    """A receiver's: none at -95 dBm, 0.3 m at -75 dBm, and no more beyond."""
    return 0.3 * np.clip((power + 95) / 20, 0, 1)


def drawn(count, seed):
    """Places in the room, powers and ranges; one range in ten is a metre and more too long."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, [5, 6], (count, 2))
    far = np.linalg.norm(places[:, None] - ROOM[None], axis=2)
    power = rng.uniform(-100, -70, far.shape)
    error = true_bias(power) + 0.03 * rng.standard_normal(far.shape)
    return places, far, power, error, rng


def test_the_curve_is_found_in_spite_of_outliers():
    _, _, power, error, rng = drawn(2000, 20)
    error = error + np.where(rng.random(error.shape) < 0.1, 1 + rng.exponential(1.0), 0.0)
    curve = fit_power_bias(power, error, knots=12)
    asked = np.array([-97.0, -90.0, -85.0, -80.0, -72.0])
    bias, std = curve.at(asked)
    np.testing.assert_allclose(bias, true_bias(asked), atol=0.02)
    assert np.all((np.asarray(std) > 0.025) & (np.asarray(std) < 0.06))
    # Beyond what was seen it stays as it is; without a power it is that of the whole.
    np.testing.assert_allclose(curve.at([-300.0, 0.0])[0], curve.bias[[0, -1]])
    assert float(curve.at(np.nan)[0]) == pytest.approx(np.median(curve.bias))


def test_positions_are_better_by_it_elsewhere():
    """Fitted on some epochs, used on others: as good as ranges without any bias."""
    _, _, power, error, _ = drawn(500, 21)
    curve = fit_power_bias(power, error)
    places, far, power, error, _ = drawn(300, 22)
    bias, std = (np.asarray(value) for value in curve.at(power))

    def rmse(measured, mean, spread):
        epochs = [
            links(ROOM, row, own, bias=shift)
            for row, shift, own in zip(measured, mean, spread, strict=True)
        ]
        stacked = type(epochs[0])(*(np.stack(leaf) for leaf in zip(*epochs, strict=True)))
        found = solve_all(Solver("ml"), stacked).position
        return np.sqrt(np.mean(np.sum((np.asarray(found) - places) ** 2, axis=1)))

    flat = np.full_like(far, 0.03)
    ideal = rmse(far + error - true_bias(power), 0 * far, flat)
    assert rmse(far + error, bias, std) < 1.1 * ideal
    assert rmse(far + error, 0 * far, flat) > 2 * ideal


def test_what_gives_no_curve():
    with pytest.raises(DataError, match="found 20 ranges for 6 knots"):
        fit_power_bias(np.arange(20.0), np.zeros(20))
    with pytest.raises(DataError, match="are too alike for 3 knots"):
        fit_power_bias(np.full(99, -80.0), np.zeros(99), knots=3)
    with pytest.raises(DataError, match="found 3 powers and 2 errors"):
        fit_power_bias([1.0, 2.0, 3.0], [1.0, 2.0])
