"""A Doppler log that loses the bottom for longer than allowed, live."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.verdicts import Verdict
from kedge.estimation.online import Estimator
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.doppler import Doppler, Measurement
from kedge.vehicles.body_twist import BodyTwist

AHEAD, LOST = np.array([1.5, 0.0, 0.0]), np.full(3, np.nan)


@pytest.fixture(scope="module")
def live():
    """5 s with the bottom, 20 s without, 2 s with it again: answers and status, every 0.2 s."""
    dvl = Installation("dvl", Doppler(std=0.02), gate=1e-4, recovery=60.0, allowed_silence=5.0)
    vehicle = BodyTwist(acceleration_noise=0.05, angular_noise=0.001)
    start = vehicle.start()._replace(velocity_body=jnp.asarray(AHEAD))
    prior = Gaussian(start, 1e-4 * jnp.eye(12))
    estimator, found = Estimator(ExtendedKalman(), Rig(vehicle, (dvl,), prior)), {}
    for tick in range(1, 136):
        seen = LOST if 25 < tick <= 125 else AHEAD
        answer = estimator.push(0.2 * tick, "dvl", Measurement(seen))
        found[tick] = answer, estimator.degraded
    return found


def test_verdicts_and_status(live):
    """Degraded as soon as the silence allowed is over, until a reading is fused."""
    for tick, (answer, degraded) in live.items():
        lost = 25 < tick <= 125
        assert answer.verdict == (Verdict.NOT_FINITE if lost else Verdict.FUSED), tick
        assert degraded == (("dvl",) if 50 < tick <= 125 else ()), tick


def test_nothing_jumps_when_the_bottom_is_back(live):
    """The position moves by what the vehicle does in a step, as far as its belief allows."""
    before, after = live[125][0].moments, live[126][0].moments
    moved = np.asarray(after.mean.position - before.mean.position)
    std = np.sqrt(np.diagonal(before.cov))[:3]
    assert std[0] > 1.0  # 20 s of not knowing how fast
    assert (np.abs(moved - 0.2 * AHEAD) < 0.1 * std).all()
    assert np.isfinite(after.cov).all()
    speed = [np.sqrt(np.diagonal(m.cov))[6:9].max() for m in (before, after)]
    assert speed[1] < 0.021 < 0.1 < speed[0]
