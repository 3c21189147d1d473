"""Late, repeated and premature events: what arrives in whatever order ends as if in order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kedge.core.errors import ContractError, DataError
from kedge.core.registry import filters
from kedge.core.verdicts import Verdict
from kedge.estimation.delayed import Origin, Window
from kedge.estimation.online import Estimator
from kedge.estimation.replay import replay
from kedge.estimation.smoother import smooth
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.sensors.gnss import Measurement
from kedge.sensors.landmarks import Measurement as Sight
from kedge.vehicles.unicycle import Control

LAG = 3.0


def story():
    """Twelve messages within the lag: controls, fixes, sightings, some at one time."""
    rng = np.random.default_rng(1)
    messages = []
    for i in range(4):
        time = 0.5 * (i + 1)
        place = np.array([time, 0.0]) + 0.3 * rng.normal(size=2)
        messages += [
            dict(time=time - 0.2, control=Control(1.0, 0.1 * i)),
            dict(time=time, sensor="gnss", measurement=Measurement(place)),
            dict(time=time, sensor="camera", measurement=Sight(20 + i, 0.9), target=i % 2),
        ]
    return messages


def leaves(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def identical(one, other):
    return all(
        np.array_equal(a, b, equal_nan=True)
        for a, b in zip(leaves(one), leaves(other), strict=True)
    )


def told(filter, rig, key, messages, **given):
    """The estimator after the messages, and its answers."""
    estimator = Estimator(filter, rig, key, **given)
    return estimator, [estimator.push(**message) for message in messages]


# Every other filter has to be so by its contract.
@pytest.mark.parametrize("name", ["extended", "ensemble"])
def test_any_order_within_the_lag_ends_as_the_order_of_the_stamps(name, rig, key):
    """The same to the last bit, since the same steps are done with the same keys."""
    filter, messages = filters.make(name), story()
    straight, _ = told(filter, rig, key, messages, lag=LAG)
    in_time, _ = told(filter, rig, key, messages)
    assert identical(straight.belief, in_time.belief)
    for order in ([11, 3, 0, 7, 5, 1, 10, 2, 9, 8, 4, 6], range(11, -1, -1)):
        shuffled, answers = told(filter, rig, key, [messages[i] for i in order], lag=LAG)
        assert identical(shuffled.belief, straight.belief)
        assert shuffled.time == straight.time
        assert sum(answer.replayed for answer in answers) > 10


@settings(max_examples=15)
@given(order=st.permutations(range(12)), doubled=st.lists(st.integers(0, 11), max_size=6))
def test_neither_order_nor_repetition_matters(order, doubled, rig, key):
    messages = story()
    straight, _ = told(ExtendedKalman(), rig, key, messages, lag=LAG)
    deliveries = [messages[i] for i in [*order, *doubled]]
    muddled, answers = told(ExtendedKalman(), rig, key, deliveries, lag=LAG)
    assert identical(muddled.belief, straight.belief)
    for answer in answers[12:]:
        assert answer.verdict == Verdict.DUPLICATE


def test_what_is_older_than_the_lag_changes_nothing(rig, key):
    messages = story()
    filter = BootstrapParticle(count=20)
    estimator, _ = told(filter, rig, key, messages, lag=0.4)
    other, _ = told(filter, rig, key, messages, lag=0.4)
    belief = estimator.belief
    late = estimator.push(1.59, "gnss", Measurement(np.zeros(2)))
    assert late.verdict == Verdict.LATE
    assert estimator.belief is belief
    ends = [e.push(2.5, "gnss", Measurement(np.ones(2))).moments for e in (estimator, other)]
    assert identical(*ends)
    inside = estimator.push(2.1, "gnss", Measurement(np.zeros(2)))
    assert inside.verdict == Verdict.FUSED
    assert inside.replayed == 1


def test_a_late_reading_answers_for_itself_and_moves_the_newest_estimate(rig, key):
    estimator, _ = told(ExtendedKalman(), rig, key, story(), lag=LAG)
    before = estimator.belief
    answer = estimator.push(1.2, "gnss", Measurement(np.array([1.5, 0.2])))
    np.testing.assert_array_equal(answer.moments.cov, estimator.belief.cov)
    assert np.trace(answer.moments.cov) < np.trace(before.cov)
    assert np.isfinite(answer.outcome.nis)


def test_a_linear_late_reading_is_the_order_of_a_joint_update(rig, key):
    """Law 5 without a replay to compare with: at rest, two fixes commute."""
    still = Control(0.0, 0.0)
    fixes = [Measurement(np.array([0.4, 0.1])), Measurement(np.array([-0.2, 0.3]))]
    late = Estimator(ExtendedKalman(), rig, key, control=still, lag=LAG)
    late.push(1.0, "gnss", fixes[1])
    late.push(0.5, "gnss", fixes[0])
    straight = Estimator(ExtendedKalman(), rig, key, control=still)
    straight.push(0.5, "gnss", fixes[0])
    straight.push(1.0, "gnss", fixes[1])
    for a, b in zip(leaves(late.belief), leaves(straight.belief), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


def test_the_sequence_orders_readings_at_one_time(rig, key):
    sights = [
        dict(time=1.0, sensor="camera", measurement=Sight(20.0 + i, 0.8), target=i, sequence=i)
        for i in range(3)
    ]
    ends = [
        told(ExtendedKalman(), rig, key, [sights[i] for i in order], lag=LAG)[0].belief
        for order in ((0, 1, 2), (2, 0, 1))
    ]
    assert identical(*ends)


def test_a_stamp_far_ahead_does_not_make_the_present_late(rig, key):
    estimator = Estimator(ExtendedKalman(), rig, key, horizon=10.0)
    estimator.push(1.0)
    belief = estimator.belief
    fix = Measurement(np.zeros(2))
    assert estimator.push(1e6, "gnss", fix).verdict == Verdict.FUTURE
    assert estimator.belief is belief
    assert estimator.push(2.0, "gnss", fix).verdict == Verdict.FUSED


def test_memory_is_bounded(rig, key):
    estimator = Estimator(ExtendedKalman(), rig, key, lag=100.0, capacity=5)
    for i in range(1, 13):
        estimator.push(0.1 * i, "gnss", Measurement(np.zeros(2)))
    assert len(estimator.smoothed()) == 5
    assert estimator.push(0.7, "gnss", Measurement(np.ones(2))).verdict == Verdict.LATE
    assert estimator.push(0.85, "gnss", Measurement(np.ones(2))).verdict == Verdict.FUSED


def test_a_push_that_raises_keeps_the_window(rig, key):
    estimator, _ = told(ExtendedKalman(), rig, key, story(), lag=LAG)
    belief = estimator.belief
    with pytest.raises(ContractError, match="no sensor 'sonar'"):
        estimator.push(1.0, "sonar", Measurement(np.zeros(2)))
    assert estimator.belief is belief


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lag": -1.0}, "lag is -1.0, expected seconds, at least 0"),
        ({"lag": float("inf")}, "lag is inf"),
        ({"horizon": 0.0}, "horizon is 0.0, expected seconds above 0"),
        ({"capacity": 0}, "capacity is 0, expected at least 1"),
    ],
)
def test_windows_that_cannot_be(rig, given, message):
    with pytest.raises(DataError, match=message):
        Estimator(ExtendedKalman(), rig, **given)


def test_the_fixed_lag_smoother_is_the_fixed_interval_smoother_of_what_came(rig, log, key):
    """Over a window that holds everything; and its first estimate is the one of least lag."""
    estimator = Estimator(
        ExtendedKalman(),
        rig,
        key,
        control=jax.tree.map(lambda leaf: leaf[0], log.controls),
        lag=10.0,
    )
    for _ in replay(estimator, log):
        pass
    _, expected = smooth(ExtendedKalman(), rig, log, key)
    found = estimator.smoothed()
    np.testing.assert_allclose([time for time, _ in found], log.schedule.time)
    moments = jax.tree.map(lambda *rows: jnp.stack(rows), *(moments for _, moments in found))
    for a, b in zip(leaves(moments), leaves(expected.moments), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_no_smoothing_without_a_gaussian(rig, key):
    with pytest.raises(ContractError, match="cannot be smoothed"):
        Estimator(BootstrapParticle(count=5), rig, key, lag=1.0).smoothed()


def test_an_event_at_the_time_of_one_forgotten_is_too_late():
    """Where memory ends before the lag does; the start itself has nothing before it."""
    words, row = np.zeros(1), np.full(5, -1)
    window = Window(Origin(0, words, words), lag=10, capacity=1)
    assert not window.too_late(0)
    for time in (1, 2):
        window.append((time, 0, 0), row, None, words)
        window.forget()
    assert window.too_late(1)
    assert not window.too_late(2)
