"""Differences of ranges in a filter: as good as ranges inside the anchors, worse outside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.estimation.batch import estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.iterated import IteratedExtendedKalman
from kedge.positioning.links import links
from kedge.positioning.solver import Solver
from kedge.sensors.range_differences import Anchor, Measurement, RangeDifferences
from kedge.vehicles.still import State, Still

HALL = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 20.0], [0.0, 20.0]])
PLACE = np.array([14.0, 9.0])


def far(place):
    return np.linalg.norm(HALL - place, axis=1)


def test_the_filter_finds_what_the_snapshot_finds():
    """Pairs whose errors are independent: against least squares by hand."""
    differences = far(PLACE)[1:] - far(PLACE)[0] + np.array([0.05, -0.1, 0.02])
    target = Anchor(HALL[1:], np.tile(HALL[:1], (3, 1)), np.zeros(3))
    sensor = Installation("uwb", RangeDifferences(target=target, std=0.1))
    prior = Gaussian(State(jnp.asarray(PLACE + 1.0)), 1e4 * jnp.eye(2))
    rig = Rig(Still(walk=0.0), (sensor,), prior)
    log = Log(
        Schedule(jnp.arange(1.0, 4.0), jnp.zeros(3, int), jnp.arange(3)),
        Still().nominal_control(0.0),
        (Readings(Measurement(jnp.asarray(differences)), jnp.arange(3)),),
    )
    found = estimate(IteratedExtendedKalman(), rig, log).moments.mean.position[-1]

    place = PLACE + 0.5
    for _ in range(30):
        unit = (place - HALL) / far(place)[:, None]
        slope = unit[1:] - unit[0]
        left = differences - (far(place)[1:] - far(place)[0])
        place = place + np.linalg.lstsq(slope, left, rcond=None)[0]
    np.testing.assert_allclose(found, place, atol=5e-3)


@pytest.mark.parametrize(
    ("place", "ratio"), [((20.0, 10.0), 1.0), ((-5.0, 10.0), 2.0), ((45.0, 25.0), 4.45)]
)
def test_against_ranges_inside_and_outside(place, ratio):
    """Ratios of an independent program: .057/.057, .102/.051, .285/.064 m at 5 cm."""
    ranges = links(HALL, far(np.asarray(place)), 0.05)
    by_range = jax.jit(Solver("ml").solve)(ranges).crlb
    by_difference = jax.jit(Solver("tdoa").solve)(ranges).crlb
    assert float(by_difference / by_range) == pytest.approx(ratio, rel=0.02)
