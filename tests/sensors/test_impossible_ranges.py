"""Readings that no place explains get a verdict, and move nothing."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.sensors.range_differences import Anchor as Pair
from kedge.sensors.range_differences import RangeDifferences
from kedge.sensors.range_epoch import RangeEpoch
from kedge.sensors.ranges import Anchor
from kedge.sensors.squared_ranges import SquaredRanges
from kedge.vehicles.still import State, Still

HIGH = Anchor(np.zeros((1, 2)), position_z=np.array([3.0]))  # 3 m over the tag
PAIR = Pair(np.array([[30.0, 0.0]]), np.zeros((1, 2)), np.array([0.5]))
EPOCH = RangeEpoch(anchors=((0.0, 0.0, 2.0), (0.0, 6.0, 2.0), (5.0, 0.0, 2.0)), std=0.1)


def verdicts(sensor, readings):
    """One reading after the other of a tag that stands at (4, 3), as far as is known."""
    count = len(readings)
    values = sensor.measures(jnp.asarray(readings))
    prior = Gaussian(State(jnp.array([4.0, 3.0])), 4.0 * jnp.eye(2))
    rig = Rig(Still(walk=0.0), (Installation("radio", sensor),), prior)
    log = Log(
        Schedule(jnp.arange(1.0, count + 1.0), jnp.zeros(count, int), jnp.arange(count)),
        Still().nominal_control(0.0),
        (Readings(values, jnp.zeros(count, int)),),
    )
    found = estimate(ExtendedKalman(), rig, log)
    return found, [Verdict(int(verdict)) for verdict in found.outcome.verdict]


@pytest.mark.parametrize(
    ("sensor", "possible", "impossible"),
    [
        # 9 m^2 straight below, with a deviation of 2 * 3 * 0.1.
        (SquaredRanges(target=HIGH, range_std=0.1), [34.0, 6.1], [5.9, 0.0, -1.0]),
        # 30 m apart, an offset of 0.5, a deviation of 0.1.
        (RangeDifferences(target=PAIR), [-29.9, 30.9, 1.0], [31.1, -30.1]),
        (
            EPOCH,
            [[5.4, 5.4, 3.7], [1.6, 5.4, 3.7], [np.nan, 5.4, 3.7]],
            [[1.4, 5.4, 3.7], [5.4, -5.4, 3.7], [5.4, 5.4, 0.0]],
        ),
    ],
)
def test_what_no_place_explains(sensor, possible, impossible):
    found, given = verdicts(sensor, [*possible, *impossible])
    assert given == [Verdict.FUSED] * len(possible) + [Verdict.NOT_FINITE] * len(impossible)
    places = np.asarray(found.moments.mean.position)
    kept = places[len(possible) - 1 : len(possible)]
    np.testing.assert_allclose(places[len(possible) :] - kept, 0.0, atol=1e-12)
