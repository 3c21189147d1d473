"""A calibration finds again what a made-up Doppler log was spoilt with."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.calibration.doppler import calibrate, typical
from kedge.core.errors import DataError
from kedge.estimation.log import Truth

TIME = np.arange(0, 300.0)
SCALE, LAG = 1.013, 1.37
SMALL, ARM = np.array([0.004, -0.006, 0.012]), np.array([-1.8, 0.1, -0.3])


def motion(time):
    """Attitude, velocity in the body and angular rate of a vehicle that snakes and bobs."""
    angles = np.stack(
        [0.8 * np.sin(time / 9), 0.1 * np.sin(time / 7), 0.2 * np.sin(time / 5)], axis=1
    )
    step = 1e-4

    def at(when):
        return Rotation.from_euler(
            "ZYX",
            np.stack(
                [0.8 * np.sin(when / 9), 0.1 * np.sin(when / 7), 0.2 * np.sin(when / 5)], axis=1
            ),
        )

    turns = Rotation.from_euler("ZYX", angles)
    rate = (at(time - step).inv() * at(time + step)).as_rotvec() / (2 * step)
    velocity = np.stack(
        [1.9 + 0.3 * np.sin(time / 11), 0.1 * np.cos(time / 6), 0.05 * np.sin(time / 8)], axis=1
    )
    return turns, velocity, rate


def log(noise=0.0):
    _, velocity, rate = motion(TIME + LAG)
    swung = velocity + np.cross(rate, ARM)
    z = SCALE * Rotation.from_rotvec(-SMALL).apply(swung)
    return z + noise * np.random.default_rng(0).normal(size=z.shape)


def reference():
    turns, velocity, _ = motion(TIME)
    return Truth(
        TIME, {"attitude": turns.as_quat()[:, [3, 0, 1, 2]], "velocity_body": velocity}
    )


def test_without_noise_it_is_exact():
    found = calibrate(TIME, log(), reference())
    np.testing.assert_allclose([found.scale, found.lag], [SCALE, LAG], atol=2e-4)
    np.testing.assert_allclose(found.misalignment, SMALL, atol=2e-4)
    np.testing.assert_allclose(found.arm, ARM, atol=2e-3)
    assert found.std < 1e-3


def test_with_noise_and_gaps_it_is_near():
    spoilt = log(0.005)
    spoilt[40:60] = np.nan
    spoilt[100] += 3.0
    found = calibrate(TIME, spoilt, reference())
    # Four standard deviations: the noise over the root of the squared slopes' sum. The velocity
    # changes by 0.026 m/s^2, with the arm's swing, and the body turns by 0.06 rad/s, rms.
    lag, arm = (4 * 0.005 / (slope * np.sqrt(280)) for slope in (0.026, 0.06))
    np.testing.assert_allclose(found.lag, LAG, atol=lag)
    np.testing.assert_allclose(found.arm, ARM, atol=arm)
    np.testing.assert_allclose(found.scale, SCALE, atol=4 * 0.005 / (1.9 * np.sqrt(280)))


def test_it_speaks_the_words_of_a_rig():
    found = typical([calibrate(TIME, log(), reference())] * 3).overrides("dvl")
    assert float(found["sensors.dvl.latency"]) == pytest.approx(-LAG, abs=1e-3)
    assert found["prior.mean.doppler_arm"].startswith("[-1.79999")


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(DataError, match="found 0 readings beside the reference"):
        calibrate(TIME + 1e4, log(), reference())
    short = reference()
    del short.fields["attitude"]
    with pytest.raises(DataError, match="the reference has no attitude"):
        calibrate(TIME, log(), short)
