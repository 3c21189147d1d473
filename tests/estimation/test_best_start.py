"""What is smoothed of a bank of hypotheses: the pass from the start that foresaw best."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.batch import compile_estimate
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.wrappers.hypotheses import Hypotheses
from kedge.sensors.gnss import Gnss
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.vehicles.unicycle import State, Unicycle

pytestmark = pytest.mark.slow


def test_the_start_that_foresaw_best_is_smoothed(key):
    """It drives west; nothing is known of the heading; the extended filter starts east."""
    vehicle, gnss = Unicycle(speed_noise=0.05), Installation("gnss", Gnss(std=0.2), rate=2.0)
    start = State(jnp.zeros(2), jnp.array(np.pi))
    sure = Rig(vehicle, (gnss,), Gaussian(start, jnp.diag(jnp.array([0.01, 0.01, 1e-6]))))
    recording, _ = record(Scenario(sure, duration=20.0), key)
    east = start._replace(heading=jnp.array(0.0))
    lost = Rig(vehicle, (gnss,), Gaussian(east, jnp.diag(jnp.array([0.01, 0.01, 9.0]))))
    bank = Hypotheses(ExtendedKalman(), count=4)
    estimates, history = compile_estimate(bank, lost, recording.log, True, key)()
    assert history is not None
    heading = np.asarray(estimates.moments.mean.heading)
    west = jax.tree.map(lambda leaf: leaf, lost.prior)
    west = west._replace(mean=start, cov=lost.prior.cov.at[2, 2].set((np.pi / 6) ** 2))
    alone, _ = compile_estimate(
        bank.inner, Rig(vehicle, (gnss,), west), recording.log, True, key
    )()
    np.testing.assert_allclose(heading, alone.moments.mean.heading, atol=1e-12)
